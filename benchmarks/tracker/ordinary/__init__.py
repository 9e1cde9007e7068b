"""Ordinary inputs: what each kind is, how it is made, and the right value or message of a command that reads it."""
