"""Surfaces as samples: how densely a view needs them, where they lie, and what they look like."""
