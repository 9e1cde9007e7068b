"""What the commands of the three packages share: bad input, messages and progress, writing files."""
