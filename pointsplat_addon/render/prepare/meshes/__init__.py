"""What meshes are drawn as: polygons, points as dense as a view needs, or nodes where they are far away."""
