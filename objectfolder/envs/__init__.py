"""Objects as rigid bodies of physics engines, and environments in which robots move them."""
