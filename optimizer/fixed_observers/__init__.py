"""Position observers in integers: the pieces they share, a module per method, and their proof."""
