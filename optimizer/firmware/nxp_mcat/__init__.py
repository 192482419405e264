"""Constants of NXP's MCAT: its rules from inputs to macros, by age, and what macros amount to."""
