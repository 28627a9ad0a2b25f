"""The protocol that every device offers, checks of what is asked of it, and numbers packed as shaders read them."""
