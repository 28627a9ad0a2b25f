"""LAS, LAZ and COPC, and octrees of files."""
