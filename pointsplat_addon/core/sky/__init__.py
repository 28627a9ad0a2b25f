"""Models of the sky, by the direction that is looked in."""
