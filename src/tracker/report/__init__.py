"""What was measured, for people: the answer in words, and a page for each recording."""
