// The normal by which a splat is shaded, if that is not the normal of its plane.

// A uniform random number in [0, 1), fixed for a splat and its instance (Jarzynski and Olano 2020, "pcg3d").
float ps_random(ivec3 element)
{
  uvec3 v = uvec3(element) * 1664525u + 1013904223u;
  v.x += v.y * v.z;
  v.y += v.z * v.x;
  v.z += v.x * v.y;
  v ^= v >> 16u;
  v.x += v.y * v.z;
  return float(v.x >> 8u) / 16777216.0;
}

// `normal`: that of the splat, turned to the viewer, where there is no other. `toward`: from the eye to the splat.
vec3 ps_lit_normal(vec3 normal, ivec3 element, mat3 linear, vec3 toward, bool turned)
{
#ifdef PS_SHADING_NORMAL
  float code = texelFetch(ps_shading_normal, element.xy, 0).x;
  if (code >= 0.0) {
    normal = ps_view_normal(linear, ps_unpack_normal(code)) * (turned ? -1.0 : 1.0);
  }
#endif
#ifdef PS_FACETS
  // One of the sides that face the viewer, each as likely as it is large in the picture.
  vec4 codes = texelFetch(ps_facets, element.xy, 0);
  float rest = 63.0;
  vec4 facets[4];
  vec4 area;
  for (int i = 0; i < 4; i++) {
    vec4 facet = ps_unpack_facet(codes[i]);
    facets[i].xyz = ps_view_normal(linear, facet.xyz);
    rest -= facet.w;
    area[i] = facet.w * max(-dot(facets[i].xyz, toward), 0.0);
  }
  float own = max(rest, 0.0) * abs(dot(normal, toward));
  float chosen = ps_random(element) * (own + area.x + area.y + area.z + area.w) - own;
  for (int i = 0; i < 4 && chosen >= 0.0; i++) {
    normal = chosen < area[i] ? facets[i].xyz : normal;
    chosen -= area[i];
  }
#endif
  return normal;
}
