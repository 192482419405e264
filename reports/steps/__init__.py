"""C written from the steps that are analysed."""
