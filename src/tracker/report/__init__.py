"""Reports of tracking: measured quantities as text, figures, and a page for each recording."""
