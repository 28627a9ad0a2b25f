"""The plain data of a scene: frozen dataclasses of numpy arrays, their bounds and their validation."""
