// Deferred shading: the G-buffer to scene-linear radiance, premultiplied, added to what earlier samples left.

#include "lib/camera.glsl"
#include "lib/lights.glsl"
#include "lib/materials.glsl"
#include "lib/geometry.glsl"

vec3 ps_finite(vec3 c)
{
  return vec3(c.x >= 0.0 && c.x < 1e30 ? c.x : 0.0, c.y >= 0.0 && c.y < 1e30 ? c.y : 0.0,
              c.z >= 0.0 && c.z < 1e30 ? c.z : 0.0);
}

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 place = texelFetch(ps_place, pixel, 0);
  vec3 normal_world = vec3(0.0);
  vec3 base = vec3(0.0);
  float distance_to_eye = 1e10;

  if (place.w == 0.0) {
#ifdef PS_BACKGROUND
    out_combined = vec4(ps_finite(ps_background(ps_ray(gl_FragCoord.xy))), 1.0);
#else
    out_combined = vec4(0.0);
#endif
  }
  else {
    vec4 shape = texelFetch(ps_shape, pixel, 0);
    vec4 packed_normal = texelFetch(ps_normal, pixel, 0);
    vec3 normal = ps_surface_normal(packed_normal.xyz, place, shape, gl_FragCoord.xy);
    vec3 position = ps_surface_position(normal, packed_normal.xyz, place, gl_FragCoord.xy);
    vec3 to_eye = -ps_ray(gl_FragCoord.xy);
    bool holdout = shape.w < -0.5;
    int material = int((holdout ? -1.0 - shape.w : shape.w) + 0.5);

    PsSurface surface = ps_material(material);
#ifdef PS_COLOR
    surface.base = texelFetch(ps_color, pixel, 0).rgb;
    surface.roughness = packed_normal.w;
    surface.metallic = texelFetch(ps_color, pixel, 0).w;
#endif
#ifdef PS_EMISSION
    surface.emission = texelFetch(ps_emission, pixel, 0).rgb;
#endif
    vec3 radiance = ps_shade(position, normal, to_eye, surface, frame.page.w);
    out_combined = holdout ? vec4(0.0) : vec4(ps_finite(radiance), 1.0);

    vec3 facing = dot(normal, to_eye) < 0.0 ? -normal : normal;
    normal_world = mat3(frame.world_from_view) * facing;
    base = surface.base * (1.0 - surface.metallic);
    distance_to_eye = ps_is_perspective() ? length(position) : -position.z;
  }
#ifdef PS_OUT_NORMAL
  out_normal_pass = vec4(normal_world, 1.0);
#endif
#ifdef PS_OUT_ALBEDO
  out_albedo = vec4(base, 1.0);
#endif
#ifdef PS_OUT_MIST
  float mist = clamp((distance_to_eye - frame.mist.x) * frame.mist.y, 0.0, 1.0);
  out_mist = vec4(frame.mist.z == 1.0 ? mist : pow(mist, frame.mist.z));
#endif
}
