// What groups of a list mirror, from the rays of those around them: one texel a group, as out_mirrored of interpolate.frag.
// Each group of the 8 x 8 pixels around one has traced another part of its lobe; what their rays have met counts by how much
// of the group's own lobe lies in that direction, over how much of the ray's lobe did.

#include "lib/geometry/camera.glsl"
#include "lib/visibility/groups.glsl"
#include "lib/visibility/listed.glsl"

#define PS_HALF 4
#define PS_MOST 4.0  // weight of what lies at the rim of the lobe that has found it

// The GGX distribution over pi.
float ps_ggx(float alpha2, float cosine)
{
  float d = cosine * cosine * (alpha2 - 1.0) + 1.0;
  return alpha2 / max(d * d, 1e-20);
}

void main()
{
  ivec2 texel = ivec2(gl_FragCoord.xy);
  vec4 place = texelFetch(ps_places, texel, 0), cells = texelFetch(ps_in_cells, texel, 0);
  vec2 kind = texelFetch(ps_kinds, texel, 0).xy;  // the share of rays in what is shown; alpha, 0: only its own count
  if (place.w == 0.0) {
    discard;
  }
  vec4 own = texelFetch(ps_shown, texel, 0);
  vec3 to_eye = ps_is_perspective() ? -normalize(place.xyz) : u.to_eye.xyz;
  vec3 normal = normalize(texelFetch(ps_rays, texel, 0).xyz + to_eye);
  float alpha2 = kind.y * kind.y;
  vec4 sum = vec4(0.0);
  float total = 0.0;
  ivec2 pixel = ps_listed(texel).pixel, last = textureSize(ps_of_pixels, 0) - 1;
  int rows = textureSize(ps_places, 0).y;
  int reach = kind.x > 0.0 && kind.y > 0.0 ? PS_HALF : -1;
  for (int y = -reach; y <= reach; y++) {
    for (int x = -reach; x <= reach; x++) {
      ivec2 at = pixel + ivec2(x, y);
      bool there = all(greaterThanEqual(at, ivec2(0))) && all(lessThanEqual(at, last));
      vec2 entry = there ? texelFetch(ps_of_pixels, at, 0).xy : vec2(0.0);  // a group; how many rays it has
      float within = (abs(x) == PS_HALF ? 0.5 : 1.0) * (abs(y) == PS_HALF ? 0.5 : 1.0);
      ivec2 other = ps_list_texel(int(entry.x));
      for (int i = 0; i < int(entry.y); i++) {
        ivec2 of_ray = ivec2(other.x, other.y + i * rows);
        vec4 end = texelFetch(ps_ends, of_ray, 0);  // place from the eye, or direction where nothing is there; density, < 0 there
        vec3 toward = normalize(end.w < 0.0 ? end.xyz : end.xyz - place.xyz);
        float cosine = dot(normalize(toward + to_eye), normal);
        float weight = min(ps_ggx(alpha2, cosine) / max(abs(end.w), 1e-20), PS_MOST);
        weight = end.w != 0.0 && dot(toward, normal) > 0.0 ? weight * within : 0.0;
        sum += weight * texelFetch(ps_shown, of_ray, 0);
        total += weight;
      }
    }
  }
  out_mirrored = mix(cells, total > 0.0 ? sum / total : own, clamp(kind.x, 0.0, 1.0));
}
