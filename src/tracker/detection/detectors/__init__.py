"""One file a detector: a callable class made from a View. The folder is the list."""
