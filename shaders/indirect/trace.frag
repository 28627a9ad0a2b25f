// Where rays first meet triangles, one texel a ray: which triangle in the tree's order, -1: none; how far along the ray; weights
// of the triangle's second and third corner. The tree is complete (core/indirect/triangle_tree.py): the bits of `trail` say at
// which levels above a node its sibling is still to be visited.

#define PS_FAR 1e30

// How far along the ray a node's box begins; PS_FAR: it misses that, or meets it beyond `most`.
float ps_box_distance(uint node, vec3 origin, vec3 inverse, float most)
{
  ivec2 texel = ivec2(2u * (node % uint(PS_NODE_WIDTH)), node / uint(PS_NODE_WIDTH));
  vec3 a = (texelFetch(ps_boxes, texel, 0).xyz - origin) * inverse;
  vec3 b = (texelFetch(ps_boxes, texel + ivec2(1, 0), 0).xyz - origin) * inverse;
  vec3 nearest = min(a, b), farthest = max(a, b);
  float enters = max(max(nearest.x, nearest.y), max(nearest.z, 0.0));
  float leaves = min(min(farthest.x, farthest.y), min(farthest.z, most));
  // Boxes of flat things have no thickness, and are rounded.
  return enters <= leaves * (1.0 + 1e-6) ? enters : PS_FAR;
}

void main()
{
  ivec2 ray = ivec2(gl_FragCoord.xy);
  vec4 start = texelFetch(ps_origins, ray, 0);
  vec3 origin = start.xyz, direction = texelFetch(ps_directions, ray, 0).xyz;
  vec3 away = vec3(direction.x < 0.0 ? -1.0 : 1.0, direction.y < 0.0 ? -1.0 : 1.0, direction.z < 0.0 ? -1.0 : 1.0);
  vec3 inverse = away / max(abs(direction), vec3(1e-12));
  uint node = 1u, trail = 0u, leaves = uint(u.leaves);
  float closest = PS_FAR;
  vec3 found = vec3(-1.0, 0.0, 0.0);
  bool going = start.w > 0.5 && ps_box_distance(1u, origin, inverse, closest) < PS_FAR;
  while (going) {
    bool inside = true;
    while (inside && node < leaves) {
      float first = ps_box_distance(2u * node, origin, inverse, closest);
      float second = ps_box_distance(2u * node + 1u, origin, inverse, closest);
      bool both = max(first, second) < PS_FAR;
      inside = min(first, second) < PS_FAR;
      node = 2u * node + (second < first ? 1u : 0u);
      trail = 2u * trail + (both ? 1u : 0u);
    }
    int begin = int(node - leaves) * u.in_leaf, end = inside ? begin + u.in_leaf : begin;
    for (int i = begin; i < end; i++) {
      ivec2 texel = ivec2(3 * (i % PS_NODE_WIDTH), i / PS_NODE_WIDTH);
      vec3 corner = texelFetch(ps_triangles, texel, 0).xyz;
      vec3 a = texelFetch(ps_triangles, texel + ivec2(1, 0), 0).xyz, b = texelFetch(ps_triangles, texel + ivec2(2, 0), 0).xyz;
      vec3 p = cross(direction, b), t = origin - corner, q = cross(t, a);  // Moeller and Trumbore 1997
      float det = dot(a, p);
      float over = 1.0 / (det == 0.0 ? 1e-37 : det);
      vec3 at = vec3(dot(b, q), dot(t, p), dot(direction, q)) * over;
      bool hit = det != 0.0 && at.y >= 0.0 && at.z >= 0.0 && at.y + at.z <= 1.0 && at.x > 0.0 && at.x < closest;
      found = hit ? vec3(float(i), at.yz) : found;
      closest = hit ? at.x : closest;
    }
    going = trail != 0u;
    int up = going ? findLSB(trail) : 0;
    node = (node >> uint(up)) ^ 1u;
    trail = (trail >> uint(up)) & ~1u;
  }
  out_hit = vec4(found.x, closest, found.yz);
}
