// Two triangles (one where all are captured, or a point with PS_POINTS) that hold a lit splat's ellipse up to the rim of its
// kernel. Layout: render/passes/translucent/page.py.
// u.turn: the first column of the matrix that takes pixels to texels of the target, which turns and scales them; u.origin:
// where pixel coordinates (0, 0) lie there. u.low_pass: by how much splats are widened. PS_LISTED: not all splats are drawn, but those of ps_listed.

#include "lib/splat/kernel.glsl"
#ifdef PS_CAPTURED
#include "lib/captured/kind.glsl"
#ifdef PS_NODES
#include "lib/captured/node.glsl"
#endif
#endif

#define PS_HUGE 1e8  // pixels^2: variance of what is drawn over all of the picture
#define PS_SHAPED 0.25  // pixels^4: determinant of the covariance above which kernels have shapes of their own

#ifdef PS_TILED
// Whether some tile in which splats are wanted is touched by a box, in pixels. Texels of ps_tiles: how many such tiles lie left of
// and below each corner.
bool ps_touches_tiles(vec2 low, vec2 high)
{
  ivec2 most = textureSize(ps_tiles, 0) - 1;
  ivec2 a = ivec2(clamp(floor(low / float(PS_TILE)), vec2(0.0), vec2(most)));
  ivec2 b = ivec2(clamp(floor(high / float(PS_TILE)) + 1.0, vec2(0.0), vec2(most)));
  return texelFetch(ps_tiles, b, 0).x - texelFetch(ps_tiles, ivec2(a.x, b.y), 0).x -
         texelFetch(ps_tiles, ivec2(b.x, a.y), 0).x + texelFetch(ps_tiles, a, 0).x > 0.5;
}
#endif

#ifdef PS_CAPTURED_ALONE
// A triangle around the ellipse: the equilateral one around a circle, by the factors of the covariance.
void main()
{
  int index = u.first + gl_VertexID / 3, corner = gl_VertexID % 3;
  ivec2 at = ivec2(index & 4095, index >> 12);
  vec4 centre = texelFetch(ps_centre, at, 0), shape = texelFetch(ps_shape, at, 0), source = texelFetch(ps_source, at, 0);
  float x = sqrt(shape.x), y = sqrt(shape.w / shape.x), lean = shape.y / shape.x;
  v_centre = centre.xy + u.principal_point + u.origin;
  v_conic = vec4(1.0 / x, lean, 1.0 / y, source.w);
  v_source = vec4(source.rgb, centre.w);
#ifdef PS_INDEXED
  v_index = float(index);
#endif
#ifdef PS_AMONG_OPAQUE
  vec4 front = texelFetch(ps_front, at, 0);
  v_front = vec4(centre.z, 1.0 / front.x, front.yz);
#ifdef PS_MATTES
  v_size = max(front.w, 1e-30);
#endif
#endif
  float faintest = centre.w / PS_LEAST_ALPHA;
#ifdef PS_NODES
  faintest = ps_is_node(source.w) ? ps_faintest(source.w) : faintest;
#endif
  float rim = sqrt(max(2.0 * log(faintest), 0.0));
  vec2 side = rim * (corner == 0 ? vec2(0.0, 2.0) : vec2(corner == 1 ? -1.7320508 : 1.7320508, -1.0));
  vec2 pixel = v_centre + vec2(x * side.x, lean * x * side.x + y * side.y);
#ifdef PS_TILED
  vec2 reach = rim * vec2(x, length(vec2(lean * x, y)));
  centre.w = ps_touches_tiles(v_centre - reach, v_centre + reach) ? centre.w : 0.0;
#endif
  gl_Position = centre.w > 0.0 ? vec4(pixel / vec2(u.size) * 2.0 - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
#else
void main()
{
#ifdef PS_POINTS
  int index = u.first + gl_VertexID;
  gl_PointSize = 1.0;
#else
  int index = u.first + gl_VertexID / 6;
#endif
  ivec2 at = ivec2(index & 4095, index >> 12);
#ifdef PS_LISTED
  at = ivec2(texelFetch(ps_listed, at, 0).xy);
#endif
  vec4 centre = texelFetch(ps_centre, at, 0), shape = texelFetch(ps_shape, at, 0);
  float a = u.turn.x, b = u.turn.y, scale = length(u.turn);
  vec3 turned = vec3(a * a * shape.x - 2.0 * a * b * shape.y + b * b * shape.z,
                     a * b * (shape.x - shape.z) + (a * a - b * b) * shape.y,
                     b * b * shape.x + 2.0 * a * b * shape.y + a * a * shape.z);
  vec3 c = turned + vec3(u.low_pass, 0.0, u.low_pass);
  float det = c.x * c.z - c.y * c.y;
  float kept = u.low_pass > 0.0 ? scale * scale * sqrt((shape.x * shape.z - shape.y * shape.y) / det) : 1.0;
  mat2 target_from_pixel = mat2(a, b, -b, a);
  v_centre = target_from_pixel * (centre.xy + u.principal_point) + u.origin;
  vec4 source = texelFetch(ps_source, at, 0);
  float rim = PS_RIM_SIGMA;
  v_source = vec4(source.rgb, kept * centre.w);
#ifdef PS_DEPTHS
  v_tint = texelFetch(ps_tint, at, 0).rgb;
#endif
#ifdef PS_CHANNEL
  v_source.w *= texelFetch(ps_tint, at, 0)[PS_CHANNEL];
#endif
  v_conic = vec4(vec3(c.z, -c.y, c.x) / det, source.w);
#ifdef PS_KERNELS
  // The shapes of splats that are no wider than a pixel would only be missed between the pixels' centres.
  v_conic.w = det > PS_SHAPED * max(scale * scale * scale * scale, 1.0) ? source.w : source.w < 0.0 ? -1.0 : 0.0;
#endif
#ifdef PS_CAPTURED
  // As factors, so that long splats keep their digits; up to where they are too faint to show.
  if (ps_is_captured(source.w)) {
    c = shape.xyz;
    det = shape.w;
    v_conic = vec4(inversesqrt(c.x), c.y / c.x, sqrt(c.x / det), source.w);
    v_source.w = centre.w;
    float faintest = centre.w / PS_LEAST_ALPHA;
#ifdef PS_NODES
    faintest = ps_is_node(source.w) ? ps_faintest(source.w) : faintest;
#endif
    rim = sqrt(max(2.0 * log(faintest), 0.0));
  }
#endif
#ifdef PS_AMONG_OPAQUE
  vec4 front = texelFetch(ps_front, at, 0);
  v_front = vec4(centre.z, 1.0 / front.x, target_from_pixel * front.yz / (scale * scale));
#ifdef PS_MATTES
  v_size = max(front.w, 1e-30);
#endif
#endif

#ifdef PS_POINTS
  // A square over what is wanted of the ellipse's box, whose middle lies in the picture: points with others are not drawn.
  vec2 reach = rim * sqrt(max(c.xz, 0.0));
  vec2 low = max(v_centre - reach, max(u.bounds.xy, vec2(0.0)));
  vec2 high = min(v_centre + reach, min(u.bounds.zw, vec2(u.size))), side = high - low;
  bool seen = centre.w > 0.0 && side.x > 0.0 && side.y > 0.0;
  gl_PointSize = max(max(side.x, side.y), 1.0);
  gl_Position = seen ? vec4((low + high) / vec2(u.size) - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
#else
  // Along the ellipse's axes where that saves much; else along the picture's, which rasterisers fill faster.
  float middle = 0.5 * (c.x + c.z), apart = 0.5 * (c.x - c.z), root = length(vec2(apart, c.y));
  float narrow = middle - root;
  bool oblique = 2.0 * det < c.x * c.z;
#ifdef PS_CAPTURED
  narrow = det / (middle + root);
  oblique = oblique && middle + root < PS_HUGE;
#endif
  float angle = oblique ? 0.5 * atan(c.y, apart) : 0.0;
  vec2 axis = vec2(cos(angle), sin(angle));
  vec2 size = rim * sqrt(max(oblique ? vec2(middle + root, narrow) : c.xz, 0.0));
  int corner = gl_VertexID % 6;
  vec2 side = vec2(corner == 1 || corner == 2 || corner == 4 ? 1.0 : -1.0, corner == 2 || corner >= 4 ? 1.0 : -1.0);
  side.x = corner == 5 ? -1.0 : side.x;
  vec2 pixel = v_centre + side.x * size.x * axis + side.y * size.y * vec2(-axis.y, axis.x);
  pixel = oblique ? pixel : clamp(pixel, u.bounds.xy, u.bounds.zw);
#ifdef PS_TILED
  vec2 reach = rim * sqrt(max(c.xz, 0.0));
  centre.w = ps_touches_tiles(v_centre - reach, v_centre + reach) ? centre.w : 0.0;
#endif
  vec2 clip = pixel / vec2(u.size) * 2.0 - 1.0;
  gl_Position = centre.w > 0.0 ? vec4(clip, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
#endif
}
#endif
