// Light that the world's fog scatters once towards the eye, along a ray. For in_fog.glsl; float64 twin: tests/reference/fog.py.
// Along a ray that passes a lamp at a distance h, the light that arrives falls as 1 / (h^2 + t^2): over the angle at which the lamp
// sees the ray it is even (Kulla and Fajardo 2012), and Gauss's rule with 16 places makes the integral without shadows. What shadows leave
// of it is the share that reaches places which are spread evenly over the same angle; their offset differs from pixel to pixel.

#define PS_FOG_DEEPEST 16.0  // optical depth beyond which nothing is seen
#define PS_FOG_FARTHEST 1e15  // whose square float32 holds
#define PS_FOG_SHADOWS 32  // places along a ray at which shadows are looked up
#define PS_FOG_CLOSEST 1e-3  // distance of a ray from a lamp over that of the lamp, below which places are taken as at this one

#if defined(PS_HAS_POINTS) || defined(PS_HAS_SPOTS) || defined(PS_HAS_AREA_LIGHTS)
#define PS_HAS_LAMPS

const float ps_gauss_node[8] = float[8](0.09501251, 0.28160355, 0.45801678, 0.61787624, 0.75540441, 0.86563120, 0.94457502,
                                        0.98940093);
const float ps_gauss_weight[8] = float[8](0.18945061, 0.18260342, 0.16915652, 0.14959599, 0.12462897, 0.09515851, 0.06225352,
                                          0.02715246);

// The ray through the fog, from where this begins for the eye.
struct PsFogRay {
  vec3 origin, direction;
  float length;
};

// From where to where along a ray a lamp shines: within a spot's cone, before an area light.
vec2 ps_lamp_shines(int index, ivec4 ends, PsFogRay ray, vec3 offset)
{
  vec2 range = vec2(0.0, ray.length);
#ifdef PS_HAS_SPOTS
  if (index >= ends.y && index < ends.z) {
    vec4 axis_u = ps_light(index, 3), axis_v = ps_light(index, 4), axis = ps_light(index, 2);
    vec3 o = vec3(dot(offset, axis_u.xyz), dot(offset, axis_v.xyz), dot(offset, axis.xyz));
    vec3 d = vec3(dot(ray.direction, axis_u.xyz), dot(ray.direction, axis_v.xyz), dot(ray.direction, axis.xyz));
    float cosine = axis_u.w, k = 1.0 / max(cosine * cosine, 1e-8) - 1.0;
    float a = dot(d.xy, d.xy) - k * d.z * d.z, b = dot(o.xy, d.xy) - k * o.z * d.z, c = dot(o.xy, o.xy) - k * o.z * o.z;
    float root = sqrt(max(b * b - a * c, 0.0)), q = b < 0.0 ? root - b : -root - b;
    float first = abs(q) > 0.0 ? c / q : 0.0, second = abs(a) > 1e-12 ? q / a : 1e30;
    vec2 between = vec2(min(first, second), max(first, second));
    // Inside the double cone between the roots, or outside of them on the side of the half that shines.
    bool closed = a > 0.0;
    bool shines = o.z + 0.5 * (between.x + between.y) * d.z > 0.0;
    vec2 open = d.z > 0.0 ? vec2(between.y, 1e30) : vec2(-1e30, between.x);
    vec2 cone = closed ? (shines && b * b > a * c ? between : vec2(0.0)) : open;
    range = cosine > 1e-4 ? vec2(max(range.x, cone.x), min(range.y, cone.y)) : range;
  }
#endif
#ifdef PS_HAS_AREA_LIGHTS
  if (index >= ends.z) {
    vec3 axis = ps_light(index, 2).xyz;
    float before = dot(offset, axis), along = dot(ray.direction, axis);
    float cut = -before / (abs(along) < 1e-12 ? 1e-12 : along);
    range = along > 0.0 ? vec2(max(range.x, cut), range.y) : vec2(range.x, min(range.y, cut));
  }
#endif
  return range;
}

// What a lamp sends to the eye by way of a place on the ray, at a distance t along it, per unit of length.
vec3 ps_airlight_at(int index, ivec4 ends, PsFogRay ray, float t, float g, out vec3 position)
{
  vec3 to_light;
  position = ray.origin + t * ray.direction;
  vec3 irradiance = ps_ball_irradiance(index, ends, position, to_light);
  float way = length(ps_light(index, 1).xyz - position);
  return irradiance * ps_phase(g, dot(to_light, ray.direction)) * ps_fog_left(t + way);
}

// jitter: in [0, 1), where between places shadows are looked up.
vec3 ps_airlight_of(int index, ivec4 ends, PsFogRay ray, float jitter)
{
  float g = ps_fog_texel(1).w;
  vec3 offset = ray.origin - ps_light(index, 1).xyz, unused;
  float middle = -dot(offset, ray.direction), away = length(offset);
  float h = max(length(offset + middle * ray.direction), PS_FOG_CLOSEST * away);
  vec2 range = ps_lamp_shines(index, ends, ray, offset);
  bool shines = range.y > range.x && h > 0.0;
  float low = atan((range.x - middle) / h), high = atan((range.y - middle) / h), half_range = 0.5 * (high - low);
  vec3 sum = vec3(0.0);
  for (int i = 0; i < (shines ? 16 : 0); i++) {
    float node = ps_gauss_node[i >> 1];
    float x = h * tan(low + half_range * (1.0 + ((i & 1) == 0 ? node : -node)));
    float weight = ps_gauss_weight[i >> 1] * half_range * (h * h + x * x) / h;
    sum += weight * ps_airlight_at(index, ends, ray, middle + x, g, unused);
  }
#ifdef PS_SHADOWS
  vec3 all = vec3(0.0), lit = vec3(0.0);
  for (int i = 0; i < (shines && any(greaterThan(sum, vec3(0.0))) ? PS_FOG_SHADOWS : 0); i++) {
    float x = h * tan(low + 2.0 * half_range * (float(i) + jitter) / float(PS_FOG_SHADOWS));
    vec3 position, found = (h * h + x * x) * ps_airlight_at(index, ends, ray, middle + x, g, position);
    all += found;
#ifdef PS_SHADOW_SPREAD
    ps_spread = PsSpread(uint(i) + uint(jitter * 4096.0) * 32u, PS_POINTS_OF_MEDIUM);
#endif
#ifdef PS_FOOTPRINT
    ps_footprint.place = position;
#endif
    lit += found * ps_transmittance(index, position, vec3(0.0), true);
  }
  sum *= lit / max(all, vec3(1e-30));
#endif
  return sum;
}

#endif

// Radiance of the fog along a ray of this length, from where the fog begins for the eye.
vec3 ps_airlight(vec3 origin, vec3 direction, float far, float jitter, int light_count)
{
  vec3 extinction = ps_fog_texel(0).rgb;
#ifdef PS_SHOWS_EMISSION
  vec3 result = ps_fog_texel(2).rgb * (1.0 - exp(-extinction * far)) / max(extinction, vec3(1e-20));
#else
  vec3 result = vec3(0.0);
#endif
#if defined(PS_HAS_LAMPS) && defined(PS_SHOWS_VOLUME)
  float least = min(extinction.r, min(extinction.g, extinction.b));
  PsFogRay ray = PsFogRay(origin, direction, min(far, min(PS_FOG_DEEPEST / max(least, 1e-20), PS_FOG_FARTHEST)));
  vec3 scattering = ps_fog_texel(1).rgb;
  ivec4 ends = ps_light_ends();
#ifdef PS_FOOTPRINT
  ps_footprint.members = uvec2(1u, 0u);
  ps_footprint.air = true;
#endif
  for (int i = ends.x; i < light_count; i++) {
    result += scattering * ps_airlight_of(i, ends, ray, jitter);
  }
#endif
  return result;
}
