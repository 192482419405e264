"""Control in integers, with proven ranges."""
