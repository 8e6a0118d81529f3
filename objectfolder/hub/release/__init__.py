"""Releases: folders of Object Files for others, with index, licences, checksums and descriptions."""
