"""Many variants of one design: rows from a study, each solved, by batches wherever that holds."""
