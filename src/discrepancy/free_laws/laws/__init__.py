"""The free laws, one file each."""
