"""Readers of films, one kind of file each: TIFF stacks, videos, folders of pictures, arrays."""
