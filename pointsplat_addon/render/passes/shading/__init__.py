"""Deferred shading of the G-buffer, the world behind it, and the passes that no light changes."""
