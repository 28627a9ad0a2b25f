"""Scans too large for memory: which pages a view needs, how they are read, and what of them is kept."""
