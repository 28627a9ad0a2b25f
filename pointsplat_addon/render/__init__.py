"""One frame: which passes a scene needs, and the passes. Handed its device; imports none."""
