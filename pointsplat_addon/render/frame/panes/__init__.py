"""Panes of one picture: translucent meshes as layers of triangles."""
