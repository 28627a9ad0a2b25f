// What panes change in each cell: their light, less what they hide of what is opaque. ps_numbers, PS_PLACES: as in
// layer.frag. PS_BEHIND: what open sub-samples show. Among translucent splats, what these send and hide, too.
// PS_CENTRED: what of it is opaque, hidden; what is seen in the end with these splats and without them, and how much they let
// through.

#include "lib/visibility/lattice.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/translucent/before.glsl"

void main()
{
  ivec2 cell = ivec2(gl_FragCoord.xy), pixel = ivec2(floor(ps_pixel_from_cell(vec2(cell) + 0.5)));
  out_change = vec4(0.0);
#ifdef PS_CENTRED
  out_seen = vec4(0.0);
  out_bare = vec4(0.0);
  out_left = 1.0;
#endif
  vec3 hidden = texelFetch(ps_hidden, cell, 0).rgb;
  bool inside = all(greaterThanEqual(pixel, ivec2(0))) && all(lessThan(pixel, u.size));
#ifdef PS_AMONG_SPLATS
  bool wanted = inside;
#else
  bool wanted = inside && hidden != vec3(0.0);
#endif
  if (wanted) {
    uvec2 codes = uvec2(texelFetch(ps_first, pixel, 0).x, texelFetch(ps_second, pixel, 0).x);
    ivec2 beside = cell - ps_central_cell(pixel) + textureSize(ps_numbers, 0) / 2;
    uint group = ps_group(codes, int(texelFetch(ps_numbers, beside, 0).x));
    bool open = group == PS_NO_GROUP;
    int entry = int(texelFetch(ps_starts, pixel, 0).x) + (open ? 0 : int(group));
    vec4 shown = open ? vec4(0.0) : texelFetch(ps_combined, ps_group_texel(entry), 0);
#ifdef PS_BEHIND
    shown = open ? texelFetch(ps_behind, pixel, 0) : shown;
#endif
    vec3 light = texelFetch(ps_light, cell, 0).rgb;
#ifdef PS_CENTRED
    out_bare = vec4(texelFetch(ps_bare, cell, 0).rgb + (1.0 - hidden) * shown.rgb,
                    shown.w + (1.0 - shown.w) * dot(hidden, vec3(1.0 / 3.0)));
#endif
#ifdef PS_AMONG_SPLATS
    PsBefore before = ps_before(cell, pixel, open ? ivec2(0) : ps_group_texel(entry), open);
#ifdef PS_CENTRED
    out_left = 1.0 - before.hidden.g;
#endif
    light += (1.0 - hidden) * before.light;
    hidden += (1.0 - hidden) * before.hidden;
#endif
    // Alpha is that of the mean of the channels, as in Cycles.
    float covered = (1.0 - shown.w) * dot(hidden, vec3(1.0 / 3.0));
#ifdef PS_CENTRED
    out_change = -shown;
    out_seen = vec4(light + (1.0 - hidden) * shown.rgb, shown.w + covered);
#else
    out_change = vec4(light - hidden * shown.rgb, covered);
#endif
  }
}
