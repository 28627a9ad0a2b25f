"""Decides what one picture shows and how it is drawn, before anything of it is on the device."""
