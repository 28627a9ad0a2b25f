// Nodes of the light tree: core/indirect/tree.py; their layout: render/passes/indirect/pages.py. PS_NODE_WIDTH: nodes in a row
// of textures, of two texels each.

struct PsNode {
  vec3 position;
  float radius;  // of a ball that holds it
  vec3 facing;  // sum of area times normal, over the area
  float area;
};

struct PsNodeLight {
  vec3 outside;  // radiance of the side that normals point to
  float closed;  // share of the area that belongs to closed surfaces
  vec3 inside;
  int first;  // child; -1: a leaf
  int octants;  // that have children, bit by bit
  bool scattered;  // leaves or hairs, and no surface
};

ivec2 ps_node_texel(int node)
{
  return ivec2(2 * (node & (PS_NODE_WIDTH - 1)), node / PS_NODE_WIDTH);
}

PsNode ps_node(int node)
{
  ivec2 at = ps_node_texel(node);
  vec4 a = texelFetch(ps_nodes, at, 0), b = texelFetch(ps_nodes, at + ivec2(1, 0), 0);
  return PsNode(a.xyz, a.w, b.xyz, b.w);
}

PsNodeLight ps_node_light(int node)
{
  ivec2 at = ps_node_texel(node);
  vec4 a = texelFetch(ps_node_lights, at, 0), b = texelFetch(ps_node_lights, at + ivec2(1, 0), 0);
  // Nine bits are the whole part of a.w, the closed share is the rest.
  float whole = floor(a.w);
  int bits = int(whole);
  return PsNodeLight(a.xyz, min((a.w - whole) * 2.0, 1.0), b.xyz, int(b.w), bits & 255, bits > 255);
}
