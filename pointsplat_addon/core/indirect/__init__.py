"""Light that is gathered from a hierarchy of surfels: what leaves surfaces, and what hides the sky."""
