"""The local estimate of a collision: free motion near the contact, with no law of the impact."""
