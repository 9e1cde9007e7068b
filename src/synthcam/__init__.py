"""Rolling steel balls: their exact motion, their picture, and the truth about both."""
