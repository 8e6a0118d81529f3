"""Sound that a vibrating surface radiates into air."""
