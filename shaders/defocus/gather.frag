// What the lens sees at a pixel: the splats of its tile from the front, and the picture of what is in focus where its
// depth is. Layout: render/passes/defocus/gather.py; reference: tests/reference/defocus.py, `composite`.

#include "lib/geometry/camera.glsl"
#include "lib/splat/defocus.glsl"
#include "lib/light/lights.glsl"
#include "lib/fog/in_fog.glsl"
#include "lib/light/backdrop.glsl"
#include "lib/geometry/finite.glsl"

#define PS_FAR 1e30
#define PS_BACK_BESIDE 0.8  // of what backs cover where fronts of the same surface are
#define PS_EVEN 0.05  // added to a sum of 1
#define PS_OPEN 0.001  // of the light from behind: less is not seen

// What was gathered from the front. Of the surface that is being gathered: how much of the lens its fronts and its backs
// cover, how far it reaches, and the colour and alpha of it; before it: the picture so far, and the light from behind
// that passes.
struct PsSeen
{
  vec4 color;
  vec3 left;
  vec4 here;
  vec3 passing;  // through what is translucent, since the surface began
  float front, back, end;
};

// Sums of kernels are uneven by some percent: what is almost whole is.
void ps_finish(inout PsSeen seen)
{
  float sum = min(max(seen.front, seen.back), 1.0), square = sum * sum, fourth = square * square;
  float covered = min(sum + PS_EVEN * fourth * fourth, 1.0);
  float scale = covered / max(sum, 1e-6);
  seen.color += vec4(seen.left, seen.left.y) * scale * seen.here;
  seen.left *= (1.0 - covered) * seen.passing;
  seen.here = vec4(0.0);
  seen.passing = vec3(1.0);
  seen.front = 0.0;
  seen.back = 0.0;
}

// An opaque splat of this colour and alpha that covers `amount` of the lens, between depth -+ reach.
void ps_cover(inout PsSeen seen, vec4 color, float amount, bool back, float depth, float reach)
{
  if (depth - reach > seen.end) {
    ps_finish(seen);
  }
  seen.end = max(seen.end, depth + reach);
  float was = min(max(seen.front, seen.back), 1.0);
  amount *= back && seen.front > 0.0 ? PS_BACK_BESIDE : 1.0;
  seen.front += back ? 0.0 : amount;
  seen.back += back ? amount : 0.0;
  float added = min(max(seen.front, seen.back), 1.0) - was;
  seen.here += added * vec4(seen.passing, seen.passing.y) * color;
}

void ps_pass(inout PsSeen seen, vec4 color, vec3 passes)
{
  vec4 share = vec4(seen.passing * (1.0 - passes), seen.passing.y * (1.0 - passes.y)) * color;
  seen.color += vec4(seen.left, seen.left.y) * share;
  seen.here -= min(max(seen.front, seen.back), 1.0) * share;
  seen.passing *= passes;
}

// How much of the light from behind what was gathered leaves, at most.
float ps_open(PsSeen seen)
{
  vec3 left = seen.left * seen.passing;
  return max(left.x, max(left.y, left.z)) * (1.0 - min(max(seen.front, seen.back), 1.0));
}

#ifdef PS_SLOPES
// The depth of a splat's plane at a pixel, v from the splat's middle: passes/defocus/tile_lists.py, `Planes`.
float ps_plane_depth(float depth, vec4 slope, vec2 v)
{
  float away = dot(slope.xy, v + slope.zw) / max(depth, 1e-30);
  return depth * (ps_is_perspective() ? 1.0 / clamp(1.0 - away, 0.25, 4.0) : 1.0 + away);
}
#endif

// The mean of what the samples of a pixel show in focus.
struct PsFocused
{
  vec4 color;
  float covered;
  float depth;
};

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec3 tile = texelFetch(ps_tiles, pixel / PS_TILE_SIZE, 0).xyz;
  int first = int(tile.x) + 4096 * int(tile.y), count = int(tile.z);
  float weight = u.sample_weight;
#ifdef PS_ADAPTIVE
  float samples = texelFetch(ps_counts, pixel / PS_TILE, 0).x;
  weight = samples > 0.0 ? 1.0 / samples : weight;
#endif
  vec2 focus = texelFetch(ps_focus, pixel, 0).xy;
  PsFocused focused = PsFocused(texelFetch(ps_focused, pixel, 0) / max(focus.y, 1e-20), weight * focus.y,
                                focus.x / max(focus.y, 1e-20));

  PsSeen seen = PsSeen(vec4(0.0), vec3(1.0), vec4(0.0), vec3(1.0), 0.0, 0.0, -PS_FAR);
  bool pending = focused.covered > 0.0;
  float thick = 2.0 * abs(ps_pixel_size(focused.depth));
  for (int i = 0; i < count && ps_open(seen) > PS_OPEN; i++) {
    int entry = first + i;
    int index = int(texelFetch(ps_list, ivec2(entry & 4095, entry >> 12), 0).x);
    ivec2 at = ivec2(index & 4095, index >> 12);
    vec4 centre = texelFetch(ps_splat_centre, at, 0), shape = texelFetch(ps_shape, at, 0);
    vec2 v = gl_FragCoord.xy - centre.xy - u.principal_point;
    int kind = int(shape.w * 0.125);
    float lies = centre.z;
#ifdef PS_SLOPES
    lies = (kind & 2) != 0 ? ps_plane_depth(lies, texelFetch(ps_slope, at, 0), v) : lies;
#endif
    if (pending && lies > focused.depth) {
      ps_cover(seen, focused.color, focused.covered, false, focused.depth, thick);
      pending = false;
    }
    float q = shape.x * v.x * v.x + 2.0 * shape.y * v.x * v.y + shape.z * v.y * v.y;
    float k = shape.w - 8.0 * float(kind);
    float share = q / (2.0 * (k + 2.0));
    // A pixel is as wide as the rim.
    float rim = clamp(length(v) * (inversesqrt(max(share, 1e-12)) - 1.0) + 0.5, 0.0, 1.0);
    float amount = centre.w * pow(max(1.0 - share, 0.002), k) * rim;
    if (amount > PS_DEFOCUS_FAINT * min(centre.w, 1.0)) {
      vec4 source = texelFetch(ps_source, at, 0), color = vec4(source.rgb, 1.0);
#ifdef PS_HOLDOUT
      color *= (kind & 4) != 0 ? 0.0 : 1.0;
#endif
      if ((kind & 10) == 0) {
        ps_cover(seen, color, amount, (kind & 1) != 0, centre.z, source.w);
      } else if ((kind & 8) != 0) {
        ps_pass(seen, color, vec3(1.0 - min(amount, 1.0)));
      } else {
#ifdef PS_TINT
        ps_pass(seen, color, exp(-amount * texelFetch(ps_tint, at, 0).rgb));
#else
        ps_pass(seen, color, vec3(exp(-amount)));
#endif
      }
    }
  }
  if (pending) {
    ps_cover(seen, focused.color, focused.covered, false, focused.depth, thick);
  }
  ps_finish(seen);
#if defined(PS_FOG)
  vec4 behind = ps_behind_fog(gl_FragCoord.xy, u.light_count);
  seen.color += vec4(seen.left, seen.left.y) * behind;
#elif defined(PS_BACKDROP)
  seen.color += vec4(seen.left * ps_backdrop_at(gl_FragCoord.xy), seen.left.y);
#elif defined(PS_BACKGROUND)
  seen.color += vec4(seen.left * ps_background(ps_ray(gl_FragCoord.xy)), seen.left.y);
#endif
  out_combined = vec4(ps_finite(seen.color.rgb), seen.color.a);
}
