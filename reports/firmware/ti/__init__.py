"""Motor blocks of TI's universal motor control lab (user_mtr1.h)."""
