// What translucent splats send to the eye from before a layer of panes or what is opaque, and what they hide of it:
// render/frame/panes/splats.py. PS_IN_CELLS: in the tiles of ps_narrow it is known of each sub-sample; PS_LISTED: in others of each
// group of the list, and with PS_OPEN_TOO of what is open. PS_TINT: what is hidden differs between the channels, by their depths.

#if defined(PS_IN_CELLS) || defined(PS_LISTED)
#define PS_AMONG_SPLATS

struct PsBefore {
  vec3 light;
  vec3 hidden;
};

// `entry`: of the list of groups; not read where the sub-sample is open.
PsBefore ps_before(ivec2 cell, ivec2 pixel, ivec2 entry, bool open)
{
  vec4 seen = vec4(0.0), depths = vec4(0.0);
#ifdef PS_LISTED
  seen = texelFetch(ps_listed, entry, 0);
#ifdef PS_TINT
  depths = texelFetch(ps_listed_depths, entry, 0);
#endif
#endif
#ifdef PS_OPEN_TOO
  seen = open ? texelFetch(ps_open, pixel, 0) : seen;
#ifdef PS_TINT
  depths = open ? texelFetch(ps_open_depths, pixel, 0) : depths;
#endif
#endif
#ifdef PS_IN_CELLS
  bool narrow = texelFetch(ps_narrow, pixel / PS_TILE, 0).x != 0.0;
  seen = narrow ? texelFetch(ps_cells, cell, 0) : seen;
#ifdef PS_TINT
  depths = narrow ? texelFetch(ps_cells_depths, cell, 0) : depths;
#endif
#endif
#ifdef PS_TINT
  return PsBefore(seen.rgb, 1.0 - exp(-depths.rgb));
#else
  return PsBefore(seen.rgb, vec3(seen.w));
#endif
}
#endif
