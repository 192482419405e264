"""Parameters of a machine from the runs of a bench, with what is not known of them."""
