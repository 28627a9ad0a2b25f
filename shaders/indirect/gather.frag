// Gathers what a receiver sees of the light tree, and of the sky behind it, without a random number (Christensen 2008;
// Ritschel et al. 2009). One texel a receiver; its layout: render/passes/indirect/gather.py.
//   out_diffuse: irradiance / pi; harmonic mean distance to what is seen
//   out_glossy: mean radiance of surfaces over the lobe around the mirrored view, and the share of the lobe that is open
// A walk meets near nodes first. A node is opened until it is smaller than a cell; then it covers as much of the cells under it
// as it is large: what surfaces cover adds up, so that they are tight; leaves and hairs hide each other as if they lay there by
// chance. PS_GLOSSY: out_glossy is wanted.

#include "lib/light/environment.glsl"
#include "lib/indirect/tree.glsl"
#include "lib/indirect/hemisphere.glsl"

#define PS_STACK 128
#define PS_ABOVE 0.05  // radii of a leaf above the receiver's plane from which on it is seen
#define PS_SKY_ROUGHNESS 0.4  // of the world's picture that is as blurred as a cell is wide

float ps_covered[PS_CELLS * PS_CELLS];  // share of the cell
float ps_weight[PS_CELLS * PS_CELLS];  // of what covers it: solid angle times cosine
float ps_inside[PS_CELLS * PS_CELLS];  // covered by closed surfaces that were entered, and not left again

struct PsGathered {
  vec3 diffuse;
  vec3 glossy;
  float nearness;  // sum of weights over distances
};

// Weight of a direction in the lobe around the mirrored view, both with z along the normal.
float ps_lobe(vec3 direction, vec4 lobe)
{
  return exp(lobe.w * (dot(direction, lobe.xyz) - 1.0));
}

void ps_add(inout PsGathered sum, vec3 radiance, float solid_angle, vec3 direction, vec4 lobe)
{
  sum.diffuse += radiance * (solid_angle * direction.z);
#ifdef PS_GLOSSY
  sum.glossy += radiance * (solid_angle * ps_lobe(direction, lobe));
#endif
}

void main()
{
  ivec2 texel = ivec2(gl_FragCoord.xy);
  ivec2 at = ivec2(3 * texel.x, texel.y);
  vec4 place = texelFetch(ps_receivers, at, 0), up = texelFetch(ps_receivers, at + ivec2(1, 0), 0);
  vec4 mirror = texelFetch(ps_receivers, at + ivec2(2, 0), 0);
  if (dot(up.xyz, up.xyz) == 0.0) {
    discard;
  }
  vec3 n = up.xyz;
  // Duff et al. 2017.
  float side = n.z >= 0.0 ? 1.0 : -1.0, a = -1.0 / (side + n.z), b = n.x * n.y * a;
  vec3 tangent = vec3(1.0 + side * n.x * n.x * a, side * b, -side * n.x);
  vec3 across = vec3(b, side + n.y * n.y * a, -n.y);
  vec4 lobe = vec4(dot(mirror.xyz, tangent), dot(mirror.xyz, across), dot(mirror.xyz, n), place.w);

  for (int i = 0; i < PS_CELLS * PS_CELLS; i++) {
    ps_covered[i] = 0.0;
    ps_weight[i] = 0.0;
    ps_inside[i] = 0.0;
  }
  PsGathered sum = PsGathered(vec3(0.0), vec3(0.0), 0.0);
  int stack[PS_STACK];
  stack[0] = u.root;
  int size = 1;
  while (size > 0) {
    size--;
    int number = stack[size];
    PsNode node = ps_node(number);
    vec3 offset = node.position - place.xyz;
    float height = dot(offset, n);
    if (height + node.radius <= 0.0) {
      continue;
    }
    float d2 = max(dot(offset, offset), 1e-24), d = sqrt(d2);
    PsNodeLight light = ps_node_light(number);
    vec3 local = vec3(dot(offset, tangent), dot(offset, across), max(height, 0.0)) / d;
    float cell = ps_cell_solid_angle(local);
    float largest = min(PS_PI * node.radius * node.radius, 2.0 * node.area) / d2;
    if (light.first >= 0 && (d < 1.5 * node.radius || largest > u.coarseness * cell) && size < PS_STACK - 8) {
      // Where the receiver lies, seen from the node; the children there come first, those opposite last.
      int own = (offset.x < 0.0 ? 1 : 0) | (offset.y < 0.0 ? 2 : 0) | (offset.z < 0.0 ? 4 : 0);
      for (int k = 7; k >= 0; k--) {
        int octant = own ^ k;
        if ((light.octants >> octant & 1) != 0) {
          stack[size] = light.first + bitCount(light.octants & ((1 << octant) - 1));
          size++;
        }
      }
      continue;
    }
    // How high it rises above its middle: as far as it is tilted.
    float upright = dot(node.facing, n), facing2 = dot(node.facing, node.facing);
    float tilt = node.radius * sqrt(clamp(1.0 - upright * upright, 0.0, 1.0));
    float top = height + tilt;
    if (top <= PS_ABOVE * node.radius) {
      continue;
    }
    float above = clamp(top / max(2.0 * tilt, 1e-20), 0.0, 1.0);
    float signed_area = -dot(node.facing, offset) / d;
    float both = min(abs(signed_area) + 0.5 * (1.0 - sqrt(min(facing2, 1.0))), 1.0);
    float angle = above * node.area / (d2 + node.area / (2.0 * PS_PI));
    float front = 0.5 * (both + signed_area) * angle, back = 0.5 * (both - signed_area) * angle;
    local.z = max(height, 0.25 * top) / d;
    local = normalize(local);
    cell = ps_cell_solid_angle(local);
    float whole = (front + back) / cell;  // in cells
    if (whole < 1e-6) {
      continue;
    }
    float half_side = clamp(0.5 * sqrt(whole), 0.25, 0.5 * float(PS_CELLS));
    vec2 centre = ps_cell_from_direction(local);
    vec2 low = clamp(centre - half_side, vec2(0.0), vec2(PS_CELLS)), high = clamp(centre + half_side, vec2(0.0), vec2(PS_CELLS));
    ivec2 first = ivec2(low), last = min(ivec2(high), ivec2(PS_CELLS - 1));
    vec2 sides = max(high - low, 1e-6);
    float share = 1.0 / (sides.x * sides.y);
    for (int y = first.y; y <= last.y; y++) {
      for (int x = first.x; x <= last.x; x++) {
        vec2 overlap = max(min(high, vec2(x + 1, y + 1)) - max(low, vec2(x, y)), 0.0);
        float part = overlap.x * overlap.y * share / cell;
        int i = y * PS_CELLS + x;
        // What leaves a closed surface that was entered in this cell is hidden by where it was entered.
        float entered = front * part, left = back * part;
        float hidden = min(light.closed * left, ps_inside[i] + light.closed * entered);
        ps_inside[i] += light.closed * entered - hidden;
        float seen_back = left - hidden, seen = entered + seen_back;
        float open = 1.0 - ps_covered[i], covers = light.scattered ? (1.0 - exp(-seen)) * open : min(seen, open);
        ps_covered[i] += covers;
        ps_weight[i] += covers * cell * local.z;
        vec3 radiance = (entered * light.outside + seen_back * light.inside) / max(seen, 1e-20);
        ps_add(sum, radiance, covers * cell, local, lobe);
        sum.nearness += covers * cell * local.z / d;
      }
    }
  }

  float whole = 0.0, whole_lobe = 0.0, open_lobe = 0.0;
  for (int y = 0; y < PS_CELLS; y++) {
    for (int x = 0; x < PS_CELLS; x++) {
      float weight = 0.0, angle = 0.0;
      for (int k = 0; k < 4; k++) {
        vec3 part = ps_direction_from_cell(vec2(x, y) + vec2(k & 1, k >> 1) * 0.5 + 0.25);
        float of_part = 0.25 * ps_cell_solid_angle(part);
        angle += of_part;
        weight += of_part * part.z;
      }
      vec3 direction = ps_direction_from_cell(vec2(x, y) + 0.5);
      int i = y * PS_CELLS + x;
      float left = 1.0 - ps_covered[i];
      // What is open of a cell that is covered in part is where it is not: on the other side of its middle.
      float left_weight = left > 1e-3 ? clamp(weight - ps_weight[i], 0.0, weight) : 0.0;
      whole += weight;
#ifdef PS_GLOSSY
      float of_lobe = angle * ps_lobe(direction, lobe);
      whole_lobe += of_lobe;
      open_lobe += left * of_lobe;
#endif
      vec3 sky = vec3(0.0);
#if defined(PS_HAS_WORLD)
      sky = texelFetch(ps_lights, ivec2(0, PS_WORLD_ROW), 0).rgb;
#elif defined(PS_HAS_ENVIRONMENT)
      for (int k = 0; k < (left > 0.0 ? 1 : 0); k++) {
        vec3 world = direction.x * tangent + direction.y * across + direction.z * n;
        sky = ps_environment_radiance(ps_image_from_view(mat3(u.view_from_world) * world), PS_SKY_ROUGHNESS);
      }
#endif
      sum.diffuse += sky * left_weight;
    }
  }
  out_glossy = vec4(sum.glossy, open_lobe) / max(whole_lobe, 1e-20);
  out_diffuse = vec4(sum.diffuse / whole, sum.nearness / whole);
}
