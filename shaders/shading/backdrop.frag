// The world behind a picture on the grid of core/lens/backdrop.py, sharp: each texel is its mean over the texel's area.
// u.texel_size: pixels that a texel spans. u.margin: texels around the blurred picture. Reference:
// tests/reference/backdrop.py, `sharp_backdrop`.

#include "lib/geometry/camera.glsl"
#include "lib/light/lights.glsl"

#define PS_TAP 0.25  // texels
#define PS_WIDE 2.0  // texels of the pyramid over the distance of taps
#define PS_NARROWEST 0.0625

// Level 1 and above of the pyramid: core/light/environment.py, `stacked`.
vec3 ps_pyramid(vec2 uv, int level)
{
  ivec2 size = textureSize(ps_levels, 0).x * ivec2(2, 1);
  ivec2 origin = ivec2(0, size.y - 2 * (size.y >> level));
  return ps_equirectangular(ps_levels, origin, size >> level, uv);
}

void main()
{
  vec2 span = u.texel_size, texel = gl_FragCoord.xy - float(u.margin) - 1.0;
  vec2 apart = PS_WIDE * 2.0 * PS_TAP * span / abs(u.focal);
  int width = 2 * textureSize(ps_levels, 0).x;
  float coarsest = log2(float(width) / 32.0);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < 4; i++) {
    vec2 tap = PS_TAP * (2.0 * vec2(float(i & 1), float(i >> 1)) - 1.0);
    vec3 ray = ps_ray((texel + tap) * span), direction = ps_image_from_view(ray);
    // Texels of the world's picture are narrow near its poles.
    float narrow = max(length(direction.xy), PS_NARROWEST);
    float wide = max(apart.x, apart.y) * -ray.z * 0.5 * float(width) / (PS_PI * narrow);
    float level = clamp(log2(wide), 0.0, coarsest);
    int low = int(level);
    vec2 uv = ps_uv_from_direction(direction);
    vec3 fine = vec3(0.0);
    if (low == 0) {
      fine = ps_environment_level(uv, 0);
    } else {
      fine = ps_pyramid(uv, low);
    }
    vec3 coarse = ps_pyramid(uv, min(low + 1, int(coarsest)));
    sum += 0.25 * mix(fine, coarse, level - float(low));
  }
  out_color = vec4(sum, 1.0);
}
