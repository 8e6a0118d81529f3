"""Errors, files, checks, materials and random generators that all rooms use."""
