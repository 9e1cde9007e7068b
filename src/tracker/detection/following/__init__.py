"""Follows balls from frame to frame: what their motion is, where they go, and which detection is theirs."""
