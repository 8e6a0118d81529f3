"""Tactile images of a vision-based sensor pressed on an object."""
