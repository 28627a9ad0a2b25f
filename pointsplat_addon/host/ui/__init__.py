"""What people see of PointSplat in Blender: properties, panels, operators and preferences."""
