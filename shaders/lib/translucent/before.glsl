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
PsBefore ps_seen(vec4 seen, vec4 depths)
{
  return PsBefore(seen.rgb, 1.0 - exp(-depths.rgb));
}
#else
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
#ifdef PS_TINT
    return ps_seen(texelFetch(ps_cells, cell, 0), texelFetch(ps_cells_depths, cell, 0));
#else
    return ps_seen(texelFetch(ps_cells, cell, 0));
#endif
  }
#endif
#ifdef PS_OPEN_TOO
  if (open) {
#ifdef PS_TINT
    return ps_seen(texelFetch(ps_open, pixel, 0), texelFetch(ps_open_depths, pixel, 0));
#else
    return ps_seen(texelFetch(ps_open, pixel, 0));
#endif
  }
#endif
#ifndef PS_LISTED
  return PsBefore(vec3(0.0), vec3(0.0));
#elif defined(PS_TINT)
  return ps_seen(texelFetch(ps_listed, entry, 0), texelFetch(ps_listed_depths, entry, 0));
#else
  return ps_seen(texelFetch(ps_listed, entry, 0));
#endif
}
#endif
