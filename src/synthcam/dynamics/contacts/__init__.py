"""Contacts of bodies with one another and with walls: when they come, and how each changes the motion."""
