// What translucent splats send to the eye from before a layer of panes or what is opaque, and what they hide of it:
// render/frame/panes/splats.py. PS_IN_CELLS: in the tiles of ps_narrow it is known of each sub-sample; PS_LISTED: in others of each
// group of the list, and with PS_OPEN_TOO of what is open. PS_TINT: what is hidden differs between the channels, by their depths.

#if defined(PS_IN_CELLS) || defined(PS_LISTED)
#define PS_AMONG_SPLATS

struct PsBefore {
  vec3 light;
  vec3 hidden;
};

#ifdef PS_TINT
#define PS_SEEN(name, at) ps_seen(texelFetch(name, at, 0), texelFetch(name##_depths, at, 0).rgb)
PsBefore ps_seen(vec4 seen, vec3 depths)
{
  return PsBefore(seen.rgb, 1.0 - exp(-depths));
}
#else
#define PS_SEEN(name, at) ps_seen(texelFetch(name, at, 0))
PsBefore ps_seen(vec4 seen)
{
  return PsBefore(seen.rgb, vec3(seen.w));
}
#endif

// `entry`: of the list of groups; not read where the sub-sample is open.
PsBefore ps_before(ivec2 cell, ivec2 pixel, ivec2 entry, bool open)
{
#ifdef PS_IN_CELLS
  if (texelFetch(ps_narrow, pixel / PS_TILE, 0).x != 0.0) {
    return PS_SEEN(ps_cells, cell);
  }
#endif
#ifdef PS_OPEN_TOO
  if (open) {
    return PS_SEEN(ps_open, pixel);
  }
#endif
#ifdef PS_LISTED
  return PS_SEEN(ps_listed, entry);
#else
  return PsBefore(vec3(0.0), vec3(0.0));
#endif
}
#endif
