"""Answers of an Object File that carry gradients: torch modules beside the queries of `ObjectFile`."""
