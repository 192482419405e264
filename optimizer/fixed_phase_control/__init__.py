"""Current control of machines with any back-EMF in integers: the step, its formats, its proof."""
