// The spread of the normals that a group of sub-samples shows: it widens the GGX lobe (Toksvig 2005; Olano and Baker 2010) and
// changes what Lambert's law gives. lib/light/brdf.glsl and round_lights.glsl read it; float64 twin: tests/reference/lighting.py.

#define PS_LEAST_SPREAD 1e-4  // variance of slopes up to which the steps of keys are as large as the spread

struct PsNormals {
  vec3 sum;
  float count;
  float within;  // sum of 1 minus the squared lengths of means over footprints
};

// Variance of slopes about the mean normal, both directions together: from so many samples of a distribution, or from means
// over footprints that fill the pixel.
float ps_normal_spread(PsNormals normals)
{
  vec3 mean = normals.sum / max(normals.count, 1.0);
  float within = normals.within / max(normals.count, 1.0);
  float length2 = max(dot(mean, mean), 1e-4), between = max(1.0 - within - length2, 0.0);
  between *= within > 0.0 ? 1.0 : normals.count / max(normals.count - 1.0, 1.0);
  return (within + (normals.count > 1.5 ? between : 0.0)) / length2;
}

#if defined(PS_MEMBER_BITS) && !defined(PS_BAKED_NORMAL) && !defined(PS_BAKED_HEIGHT)
// Shades a group by the mean of the normals in its sub-samples' keys, and keeps their spread. Where that is no larger than the
// steps of keys, the normal stays the leader's own, which has none. `pixel`, `layer`: the group.
void ps_shade_by_keys(inout PsSurfel s, ivec2 pixel, int layer)
{
  uvec2 codes = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
  ivec2 middle = ps_central_cell(pixel);
  PsNormals normals = PsNormals(vec3(0.0), 0.0, 0.0);
  for (uvec2 members = ps_group_members(codes, uint(layer)); (members.x | members.y) != 0u;) {
    normals.sum += ps_key_normal(texelFetch(ps_keys, middle + ps_next_member(members), 0).x);
    normals.count += 1.0;
  }
  float spread = ps_normal_spread(normals);
  float known = clamp(spread / PS_LEAST_SPREAD - 1.0, 0.0, 1.0);
  s.normal.xyz = ps_direction(mix(s.normal.xyz, ps_direction(normals.sum, s.normal.xyz), known), s.normal.xyz);
  s.centre.y = known * spread;
}
#endif
