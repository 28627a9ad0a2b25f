// Nodes of the light tree: core/indirect/tree.py; layout: render/passes/indirect/pages.py. PS_NODE_WIDTH: nodes in a row of the
// texture, of four texels each.

#include "lib/data/pack.glsl"

// Of bits of nodes.
#define PS_IS_SCATTERED 256
#define PS_IS_ROUND (1 << 21)
#define PS_IS_CAPTURED (1 << 22)
#define PS_IS_SHINING (1 << 23)
#define PS_IS_ROUGH (1 << 24)

#define PS_EVEN_HAIRS 0.38314993  // 1 - (pi / 4)^2

struct PsNode {
  vec3 position;
  float radius;  // of a ball that holds it
  float area;
  int first;  // child; < 0: a leaf
  int bits;
  float axis;  // of hairs along which most of them run
};

struct PsNodeLook {
  vec3 facing;  // sum of area times normal, over the area
  vec3 axis;  // along which most normals lie
  float along;  // how far they do
  bool scattered;  // leaves or hairs, and no surface
  bool solid;  // leaves and hairs that are bodies: all that goes in at a front leaves at a back
#ifdef PS_CAPTURED
  bool captured;  // captured splats
#endif
  vec3 before, behind;  // radiance of the side that the axis points to, and of the other
  vec3 inside;  // of surfaces, from behind
};

ivec2 ps_node_texel(int node)
{
  return ivec2(4 * (node & (PS_NODE_WIDTH - 1)), node / PS_NODE_WIDTH);
}

PsNode ps_node(int node)
{
  ivec2 at = ps_node_texel(node);
  vec4 a = texelFetch(ps_nodes, at, 0), b = texelFetch(ps_nodes, at + ivec2(1, 0), 0);
  return PsNode(a.xyz, a.w, abs(b.x), int(b.y), int(b.z) | (b.x < 0.0 ? PS_IS_ROUGH : 0), b.w);
}

vec3 ps_unpack_radiance(vec2 codes)
{
  float exponent = floor(codes.x / 4096.0), green = floor(codes.y / 4096.0);
  vec3 steps = vec3(codes.x - 4096.0 * exponent, green, codes.y - 4096.0 * green);
  return steps * exp2(exponent - 1036.0);
}

bool ps_is_hairs(PsNode node)
{
  return (node.bits & (PS_IS_SCATTERED | PS_IS_ROUND)) == (PS_IS_SCATTERED | PS_IS_ROUND);
}

// How far normals lie along the axis, or hairs run along it.
float ps_along_axis(PsNode node)
{
  return float(node.bits >> 9 & 63) / 63.0;
}

// How far normals lie along the axis; hairs have none.
float ps_along(PsNode node)
{
  return ps_is_hairs(node) ? 0.0 : ps_along_axis(node);
}

// What hairs show of their surface, over half of it, from a direction with this cosine to their axis: a tube 2 / pi times the sine,
// and as many that run all ways a half.
float ps_shown_of_hairs(PsNode node, float cosine)
{
  float along = ps_along_axis(node);
  return 2.0 / PS_PI * sqrt(max(1.0 - along * cosine * cosine - (1.0 - along) * PS_EVEN_HAIRS, 0.0));
}

// How far it reaches along the axis at most, either way, over its radius.
float ps_thickness(PsNode node)
{
  return float(node.bits >> 15 & 63) / 63.0;
}

PsNodeLook ps_node_look(int number, PsNode node)
{
  ivec2 at = ps_node_texel(number);
  vec4 a = texelFetch(ps_nodes, at + ivec2(2, 0), 0), b = texelFetch(ps_nodes, at + ivec2(3, 0), 0);
  PsNodeLook look;
  look.facing = ps_unpack_normal(a.x) * abs(a.y);
  look.axis = ps_unpack_normal(node.axis);
  look.along = ps_along(node);
  look.scattered = (node.bits & PS_IS_SCATTERED) != 0;
  look.solid = a.y < 0.0;
#ifdef PS_CAPTURED
  look.captured = (node.bits & PS_IS_CAPTURED) != 0;
#endif
  look.before = ps_unpack_radiance(a.zw);
  look.behind = ps_unpack_radiance(b.xy);
  look.inside = ps_unpack_radiance(b.zw);
  return look;
}

struct PsLeafEdge {
  vec2 turn;  // cosine and sine of how far it is turned about the axis
  float ratio;  // its length over that of a square
  bool half_of_it;  // the leaf is a triangle with a right angle, half of a rectangle
};

PsLeafEdge ps_leaf_edge(PsNode node)
{
  int code = -2 - node.first;
  float turn = code < 0 ? 0.0 : float(code >> 10 & 1023) * (2.0 * PS_PI / 1024.0);
  float ratio = code < 0 ? 1.0 : exp2(float((code & 1023) - 512) / 64.0);
  return PsLeafEdge(vec2(cos(turn), sin(turn)), ratio, code >= 1 << 20);
}
