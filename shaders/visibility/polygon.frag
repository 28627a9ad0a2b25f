// Polygons into the G-buffer that points share: splats of radius zero (Marroquim et al. 2008, section 5).

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/geometry/camera.glsl"
#include "lib/geometry/direction.glsl"
#include "lib/data/polygon.glsl"
#ifdef PS_CUT
#include "lib/visibility/cut.glsl"
#endif

void main()
{
#ifdef PS_LEVELS
  v_footprint = ps_pixel_footprint(v_uv, v_patch, u.footprint, ps_texels());
#endif
#ifdef PS_CUT
  if (ps_is_cut_out(ps_polygon_alpha(), v_cut, 0.0, gl_FragCoord.xy)) {
    discard;
  }
#endif
#ifdef PS_CULL
  if (gl_FrontFacing == (u.mirrored == 1)) {
    discard;
  }
#endif
  float d = -v_position.z;
  float material = float(u.material);
  PsSurfel s = ps_empty();
  s.centre = vec4(d, 0.0, 0.0, PS_POLYGON);
  s.shape = vec4(0.0, 0.0, 0.0, u.holdout == 1 ? -1.0 - material : material);
#ifdef PS_NORMAL
  s.normal.xyz = normalize(v_normal);
  vec3 plane = ps_direction(cross(dFdx(v_position), dFdy(v_position)), vec3(0.0, 0.0, 1.0));
  bool turned = !gl_FrontFacing, away = dot(plane, ps_is_perspective() ? v_position : vec3(0.0, 0.0, -1.0)) > 0.0;
  plane = turned == away ? plane : -plane;
#ifdef PS_BAKED_NORMAL
  s.normal.xyz = ps_bent(s.normal.xyz, ps_picture(ps_baked_normal, v_uv).xyz, dFdx(v_position), dFdy(v_position),
                         dFdx(v_uv), dFdy(v_uv));
#endif
#ifdef PS_BAKED_HEIGHT
  mat2x3 tilts = ps_tilts(s.normal.xyz, dFdx(v_position), dFdy(v_position), dFdx(v_uv), dFdy(v_uv));
  s.normal.xyz = ps_raised(s.normal.xyz, ps_slope(v_uv), turned ? -1.0 : 1.0, tilts);
#endif
  ps_seen_from(s, plane, turned);
#endif
  ps_polygon_attributes(s);
#ifdef PS_LEVELS
  ps_filtered_attributes(s);
#endif
#ifdef PS_OWNER
  s.owner = uint(u.instance);
#endif
  ps_store_front(s, true);
  gl_FragDepth = ps_buffer_depth(d);
}
