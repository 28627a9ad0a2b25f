// Polygons into the G-buffer that points share: splats of radius zero (Marroquim et al. 2008, section 5).

#include "lib/geometry/surfel.glsl"
#include "lib/data/store.glsl"
#include "lib/geometry/camera.glsl"

#ifdef PS_UV
vec4 ps_repeat(sampler2D picture, vec2 uv)
{
  ivec2 size = textureSize(picture, 0);
  vec2 p = (uv - floor(uv)) * vec2(size) - 0.5;
  ivec2 low = ivec2(floor(p));
  vec2 f = p - vec2(low);
  ivec2 a = (low + size) % size;
  ivec2 b = (low + 1) % size;
  return mix(mix(texelFetch(picture, a, 0), texelFetch(picture, ivec2(b.x, a.y), 0), f.x),
             mix(texelFetch(picture, ivec2(a.x, b.y), 0), texelFetch(picture, b, 0), f.x), f.y);
}
#endif

#ifdef PS_BAKED_NORMAL
// The tangent frame from how position and UV change over the screen, since meshes carry no tangents here.
vec3 ps_bent(vec3 n, vec3 tangent_space)
{
  vec3 px = dFdx(v_position), py = dFdy(v_position);
  vec2 ux = dFdx(v_uv), uy = dFdy(v_uv);
  vec3 t = cross(py, n) * ux.x + cross(n, px) * uy.x;
  vec3 b = cross(py, n) * ux.y + cross(n, px) * uy.y;
  float size = inversesqrt(max(max(dot(t, t), dot(b, b)), 1e-30));
  return normalize(t * size * tangent_space.x + b * size * tangent_space.y + n * tangent_space.z);
}
#endif

void main()
{
#ifdef PS_BAKED_ALPHA
  if (ps_repeat(ps_baked_color, v_uv).a < 0.5) {
    discard;
  }
#endif
#ifdef PS_CORNER_ALPHA
  if (v_color.a < 0.5) {
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
#ifdef PS_BAKED_NORMAL
  s.normal.xyz = ps_bent(s.normal.xyz, ps_repeat(ps_baked_normal, v_uv).xyz);
#endif
#endif
#ifdef PS_COLOR
#if defined(PS_BAKED_COLOR)
  s.color.rgb = ps_repeat(ps_baked_color, v_uv).rgb;
#elif defined(PS_CORNER_COLOR)
  s.color.rgb = v_color.rgb;
#else
  s.color.rgb = texelFetch(ps_materials, ivec2(0, u.material), 0).rgb;
#endif
#endif
#ifdef PS_SURFACE
#if defined(PS_BAKED_SURFACE)
  vec2 surface = ps_repeat(ps_baked_surface, v_uv).xy;
#elif defined(PS_CORNER_SURFACE)
  vec2 surface = v_surface;
#else
  vec2 surface = texelFetch(ps_materials, ivec2(2, u.material), 0).yz;
#endif
  s.normal.w = surface.x;
  s.color.w = surface.y;
#endif
#ifdef PS_EMISSION
#if defined(PS_BAKED_EMISSION)
  s.emission = vec4(ps_repeat(ps_baked_emission, v_uv).rgb, 0.0);
#elif defined(PS_CORNER_EMISSION)
  s.emission = vec4(v_emission, 0.0);
#else
  s.emission = vec4(texelFetch(ps_materials, ivec2(1, u.material), 0).rgb, 0.0);
#endif
#endif
#ifdef PS_OWNER
  s.owner = uint(u.instance);
#endif
  ps_store_front(s, true);
  gl_FragDepth = ps_buffer_depth(d);
}
