"""Shaders as text plus a declared interface, the same for every device."""
