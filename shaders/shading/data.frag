// Passes that are not averaged: what lies under the pixel's centre in the first sample. PS_MATTES: some of it is not seen.

#include "lib/geometry/camera.glsl"
#include "lib/geometry/surfel_kind.glsl"
#include "lib/geometry/geometry.glsl"

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 centre = texelFetch(ps_centre, pixel, 0);
  bool there = ps_is_there(centre);
  vec3 position = vec3(0.0, 0.0, -1e10);
  vec4 shape = vec4(0.0);
#ifdef PS_MATTES
  there = there && !ps_is_matte(texelFetch(ps_shape, pixel, 0));
#endif
  if (there) {
    shape = texelFetch(ps_shape, pixel, 0);
    vec3 stored = texelFetch(ps_normal, pixel, 0).xyz;
    position = ps_surface_position(ps_surface_normal(stored, centre, shape, gl_FragCoord.xy), stored, centre,
                                   gl_FragCoord.xy);
  }
#ifdef PS_OUT_POSITION
  out_position = there ? vec4((u.world_from_view * vec4(position, 1.0)).xyz, -position.z) : vec4(0.0, 0.0, 0.0, 1e10);
#endif
#ifdef PS_OWNER
  int owner = there ? int(texelFetch(ps_owner, pixel, 0).x) : -1;
#else
  const int owner = -1;
#endif
#ifdef PS_OUT_INDEX
  out_index = vec4(owner, there ? (shape.w < -0.5 ? -1.0 - shape.w : shape.w) : -1.0, 0.0, 0.0);
#endif
#ifdef PS_OUT_VECTOR
  out_vector = vec4(0.0);
  if (there) {
#ifdef PS_VELOCITY
    vec4 q = vec4(position - texelFetch(ps_owner, pixel, 0).yzw, 1.0);
#else
    vec4 q = vec4(position, 1.0);
#endif
    vec4 rows[4];
    for (int i = 0; i < 4; i++) {
      int t = owner * 4 + i;
      rows[i] = texelFetch(ps_previous, ivec2(t & 4095, t >> 12), 0);
    }
    vec4 clip = vec4(dot(rows[0], q), dot(rows[1], q), dot(rows[2], q), dot(rows[3], q));
    vec2 before = (clip.xy / clip.w * 0.5 + 0.5) * u.resolution - u.corner;
    vec2 motion = clip.w > 0.0 ? before - gl_FragCoord.xy : vec2(0.0);
    out_vector = vec4(motion, motion);
  }
#endif
}
