"""Current control of machines with any back-EMF on any topology: gains, tables, stability."""
