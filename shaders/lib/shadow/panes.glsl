// Shadows of panes, by layers of depth maps: layout in render/shadow/panes.py, which also tells how they are drawn. Each layer holds
// how far away a pane is, and above it the share of light that it and all before it let through.
// PS_SHADOW_PANES: some light has such a map. PS_PANES_COLORED: it holds shares of each channel. PS_FOOTPRINT: as in map.glsl.

#ifdef PS_SHADOW_PANES

#define PS_PANES_ALIKE 1e-3

#ifdef PS_PANES_COLORED
#define PsShare vec3
#define ps_most(share) max(share.r, max(share.g, share.b))
#else
#define PsShare float
#define ps_most(share) share
#endif

// Share of the light that panes let through to a point in view space, between the four texels around it.
PsShare ps_panes_through(PsMapLight light, vec3 position, vec3 normal, float above, float rise)
{
  PsMapPlace at = ps_map_place(light, ps_pane_lights, position, normal, above, rise);
  int layers = at.seen ? int(light.head.y) : 0, next = int(light.head.z), height = int(light.head.w);
  PsShare through = PsShare(0.0);
  for (int i = 0; i < 4; i++) {
    vec2 corner = vec2(i & 1, i >> 1);
    ivec2 texel = ps_map_texel(at, corner);
    uint limit = ps_map_limit(at, corner);
    int before = 0;  // layers that lie before the receiver
    while (before < layers && texelFetch(ps_shadow_panes, texel + ivec2(0, before * next), 0).x < limit) {
      before++;
    }
    PsShare share = PsShare(1.0);
    for (int k = 0; k < min(before, 1); k++) {
      ivec2 shares = texel + ivec2(0, (before - 1) * next + height);
#ifdef PS_PANES_COLORED
      share = uintBitsToFloat(uvec3(texelFetch(ps_shadow_panes, shares, 0).x,
                                    texelFetch(ps_shadow_panes, shares + ivec2(0, height), 0).x,
                                    texelFetch(ps_shadow_panes, shares + ivec2(0, 2 * height), 0).x));
#else
      share = uintBitsToFloat(texelFetch(ps_shadow_panes, shares, 0).x);
#endif
    }
    through += share * ps_map_weight(at, corner);
  }
  return through;
}

// Share of the light of light `light` that panes let through to a point in view space.
PsShare ps_pane_share(int light, vec3 position, vec3 normal, bool wanted)
{
  PsMapLight map = ps_map_light(ps_pane_lights, light);
  wanted = wanted && map.head.x > 0.0;
#ifdef PS_FOOTPRINT
  uvec2 members = wanted ? ps_footprint.members : uvec2(0u);
  PsShare sum = PsShare(0.0), least = PsShare(1.0), most = PsShare(0.0);
  float count = 0.0;
  while ((members.x | members.y) != 0u) {
    PsMember member = ps_member(members, normal);
    PsShare through = ps_panes_through(map, member.position, member.normal, ps_footprint.above, ps_footprint.rise);
    sum += through;
    count += 1.0;
    least = min(least, through);
    most = max(most, through);
    PsShare apart = most - least;
    members = count == float(PS_MAP_FIRST) && ps_most(apart) < PS_PANES_ALIKE ? uvec2(0u) : members;
  }
  return count > 0.0 ? sum / count : PsShare(1.0);
#else
  PsShare through = PsShare(1.0);
  for (int i = 0; i < (wanted ? 1 : 0); i++) {
    through = ps_panes_through(map, position, normal, PS_MAP_BIAS, 0.0);
  }
  return through;
#endif
}

#endif
