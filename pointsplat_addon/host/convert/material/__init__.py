"""Blender's materials as core's table of materials: surfaces, media, node trees and images."""
