"""What is downloaded, imported or published: an annex."""
