"""What a study computed, on disk: parts that are sealed, found again, looked into and exported."""
