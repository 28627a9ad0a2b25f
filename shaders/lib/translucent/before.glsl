// What translucent splats send to the eye from before a layer of panes or what is opaque, and what they hide of it:
// render/frame/panes/splats.py. PS_IN_CELLS: in the tiles of ps_narrow it is known of each sub-sample; PS_LISTED: in others of each group
// of the list, and with PS_OPEN_TOO of what is open. PS_TINT: what is hidden differs between the channels, and is found by what is
// seen of white.

#if defined(PS_IN_CELLS) || defined(PS_LISTED)
#define PS_AMONG_SPLATS

struct PsBefore {
  vec3 light;
  vec3 hidden;
};

// `entry`: of the list of groups; not read where the sub-sample is open.
PsBefore ps_before(ivec2 cell, ivec2 pixel, ivec2 entry, bool open)
{
  PsBefore found = PsBefore(vec3(0.0), vec3(0.0));
#ifdef PS_IN_CELLS
  if (texelFetch(ps_narrow, pixel / PS_TILE, 0).x != 0.0) {
    vec4 seen = texelFetch(ps_cells, cell, 0);
    found.light = seen.rgb;
#ifdef PS_TINT
    found.hidden = 1.0 - (texelFetch(ps_cells_white, cell, 0).rgb - seen.rgb);
#else
    found.hidden = vec3(seen.w);
#endif
    return found;
  }
#endif
#ifdef PS_OPEN_TOO
  if (open) {
    vec4 seen = texelFetch(ps_open, pixel, 0);
    found.light = seen.rgb;
#ifdef PS_TINT
    found.hidden = 1.0 - (texelFetch(ps_open_white, pixel, 0).rgb - seen.rgb);
#else
    found.hidden = vec3(seen.w);
#endif
    return found;
  }
#endif
#ifdef PS_LISTED
  vec4 seen = texelFetch(ps_listed, entry, 0);
  found.light = seen.rgb;
#ifdef PS_TINT
  found.hidden = texelFetch(ps_listed_hidden, entry, 0).rgb;
#else
  found.hidden = vec3(seen.w);
#endif
#endif
  return found;
}
#endif
