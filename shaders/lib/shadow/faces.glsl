// Shadows of panes from lights with a size, by the panes' faces: layout in render/shadow/pane_faces.py. PS_SHADOW_FACES: some light
// looks at them. PS_FOOTPRINT: as in map.glsl; the sub-samples of a group take turns.
//
// What a face covers of a light, as a receiver sees it, lies within the planes through the receiver and the face's edges, and beyond
// the face's own. Over the light's outline, x and y from -1 to 1, the place within each of them is linear. Where that does not tell
// that all or nothing of the light is covered, the cells of the outline do, each as far as its middle lies within.

#ifdef PS_SHADOW_FACES

#define PS_FACE_CELLS 6  // along a side of the outline's square
#define PS_FACE_SQUARE (2.0 / float(PS_FACE_CELLS))  // sides of a cell: of a rectangle,
#define PS_FACE_DISK (1.7724539 / float(PS_FACE_CELLS))  // and of a disk
#define PS_FACE_PLANES 5
#define PS_FACE_ROUNDING 4e-6  // of distances: a receiver that lies in a face's plane is not behind it

struct PsFaceLight {
  bool parallel, rectangle;
  vec3 middle, half_u, half_v;  // of suns: direction towards it, and what is added to that
  int first, count;  // rows of faces
};

// Linear functions over a light's outline, positive within a plane: at its middle, along x, along y.
struct PsFacePlanes {
  vec3 inside[PS_FACE_PLANES];
  float blur[PS_FACE_PLANES];  // by which they differ between the sub-samples of a pixel
};

PsFaceLight ps_face_light(int light, vec3 position)
{
  vec4 head = texelFetch(ps_pane_faces, ivec2(0, light), 0), first = texelFetch(ps_pane_faces, ivec2(1, light), 0);
  vec4 second = texelFetch(ps_pane_faces, ivec2(2, light), 0), faces = texelFetch(ps_pane_faces, ivec2(3, light), 0);
  bool rectangle = first.w > 0.5, facing = second.w > 0.5;
  PsFaceLight found = PsFaceLight(head.w < 1.5, rectangle, head.xyz, first.xyz, second.xyz, int(faces.x), int(faces.y));
  if (facing) {
    vec3 toward = normalize(head.xyz - position), size = abs(toward);
    vec3 other = size.x < min(size.y, size.z) ? vec3(1, 0, 0) : size.y < size.z ? vec3(0, 1, 0) : vec3(0, 0, 1);
    vec3 across = normalize(cross(toward, other));
    found.half_u = length(first.xyz) * across;
    found.half_v = length(first.xyz) * cross(toward, across);
  }
  return found;
}

// Shares of light that pass a face, by its row, and the number of its sheet.
vec4 ps_face_through(int row)
{
  return vec4(texelFetch(ps_pane_faces, ivec2(0, row), 0).w, texelFetch(ps_pane_faces, ivec2(1, row), 0).w,
              texelFetch(ps_pane_faces, ivec2(2, row), 0).w, texelFetch(ps_pane_faces, ivec2(3, row), 0).w);
}

// Returns whether the face may lie between the light and a receiver. pixel: how large a pixel is there, world units.
bool ps_face_planes(PsFaceLight light, int face, vec3 at, float pixel, out PsFacePlanes planes)
{
  vec3 corner[4];
  for (int i = 0; i < 4; i++) {
    corner[i] = texelFetch(ps_pane_faces, ivec2(i, light.first + face), 0).xyz - at;
  }
  vec3 toward = light.parallel ? light.middle : light.middle - at;
  // In a unit in which products of lengths are numbers.
  float unit = 1.0 / max(length(corner[0]) + (light.parallel ? 0.0 : length(toward)), 1e-30);
  float of_light = light.parallel ? 1.0 : unit;
  for (int i = 0; i < 4; i++) {
    corner[i] *= unit;
  }
  toward *= of_light;
  vec3 half_u = of_light * light.half_u, half_v = of_light * light.half_v;
  vec3 normal = cross(corner[2] - corner[0], corner[3] - corner[1]);
  float height = dot(normal, corner[0]), side = height < 0.0 ? -1.0 : 1.0;
  for (int i = 0; i < 4; i++) {
    vec3 next = corner[(i + 1) & 3], plane = side * cross(corner[i], next);
    planes.inside[i] = vec3(dot(plane, toward), dot(plane, half_u), dot(plane, half_v));
    planes.blur[i] = pixel * unit * length(cross(next - corner[i], toward - (light.parallel ? vec3(0.0) : corner[i])));
  }
  planes.inside[4] = vec3(side * dot(normal, toward) - abs(height), side * dot(normal, half_u), side * dot(normal, half_v));
  planes.inside[4] = light.parallel ? vec3(1.0, 0.0, 0.0) : planes.inside[4];
  planes.blur[4] = pixel * unit * length(normal);
  return abs(height) > PS_FACE_ROUNDING * (1.0 + length(at) * unit) * length(normal);
}

// What a face covers of a cell with this side around a place of the outline.
float ps_face_covers(PsFacePlanes planes, vec2 place, float side)
{
  float covered = 1.0;
  for (int i = 0; i < PS_FACE_PLANES; i++) {
    vec3 inside = planes.inside[i];
    float there = inside.x + dot(inside.yz, place), width = side * length(inside.yz);
    covered *= width > 0.0 ? clamp(there / width + 0.5, 0.0, 1.0) : step(0.0, there);
  }
  return covered;
}

// Of the outline: a place in the square, or in the disk onto which that is mapped (Shirley and Chiu 1997).
vec2 ps_face_place(vec2 square, bool rectangle)
{
  vec2 size = abs(square);
  bool wide = size.x > size.y;
  float angle = 0.78539816 * (wide ? square.y / square.x : 2.0 - square.x / square.y);
  return rectangle ? square : (wide ? square.x : square.y) * vec2(cos(angle), sin(angle));
}

// How much of the light at a place of the outline comes to a receiver if nothing keeps it, in a unit of its own.
float ps_face_weight(PsFaceLight light, vec3 at, vec3 normal, vec2 place)
{
  vec3 point = light.middle + place.x * light.half_u + place.y * light.half_v;
  float unit = light.parallel ? 1.0 : 1.0 / max(distance(light.middle, at), 1e-30);
  vec3 toward = light.parallel ? point : (point - at) * unit;
  float square = light.parallel ? 1.0 : max(dot(toward, toward), 1e-8);
  return dot(normal, normal) > 0.0 ? max(dot(normal, toward), 1e-6) / (square * square) : 1.0;
}

// Share of the light of light `light` that the faces of panes let through to a point in view space.
vec3 ps_face_share(int light, vec3 position, vec3 normal, bool wanted)
{
  wanted = wanted && texelFetch(ps_pane_faces, ivec2(0, light), 0).w > 0.5;
  if (!wanted) {
    return vec3(1.0);
  }
  PsFaceLight from = ps_face_light(light, position);
  float side = from.rectangle ? PS_FACE_SQUARE : PS_FACE_DISK;
#ifdef PS_FOOTPRINT
  float pixel = ps_pixel_size(-position.z);
  uvec2 members = uvec2(0u);
#else
  const float pixel = 0.0;
#endif
  vec3 whole = vec3(1.0);
  uvec2 mixed = uvec2(0u);  // faces that cover the light in part
  PsFacePlanes planes;
  for (int i = 0; i < from.count; i++) {
    bool some = ps_face_planes(from, i, position, pixel, planes), all_of_it = some;
    for (int k = 0; k < PS_FACE_PLANES; k++) {
      vec3 inside = planes.inside[k];
      float reach = from.rectangle ? abs(inside.y) + abs(inside.z) : length(inside.yz);
      reach += 0.5 * side * length(inside.yz) + planes.blur[k];
      some = some && inside.x > -reach;
      all_of_it = all_of_it && inside.x >= reach;
    }
    if (all_of_it) {
      whole *= ps_face_through(from.first + i).rgb;
    }
    mixed[i >> 5] |= some && !all_of_it ? 1u << uint(i & 31) : 0u;
  }
  if ((mixed.x | mixed.y) == 0u) {
    return whole;
  }
  vec3 sum = vec3(0.0);
  float total = 0.0;
  for (int cell = 0; cell < PS_FACE_CELLS * PS_FACE_CELLS; cell++) {
    vec3 at = position;
#ifdef PS_FOOTPRINT
    members = (members.x | members.y) == 0u ? ps_footprint.members : members;
    at = ps_member(members, normal).position;
#endif
    vec2 square = (vec2(cell % PS_FACE_CELLS, cell / PS_FACE_CELLS) + 0.5) * PS_FACE_SQUARE - 1.0;
    vec2 place = ps_face_place(square, from.rectangle);
    vec3 share = vec3(1.0);
    vec4 sheet = vec4(1.0, 1.0, 1.0, -1.0);  // shares of light of the faces of which, and its number
    float covered = 0.0;
    uvec2 left = mixed;
    while ((left.x | left.y) != 0u) {
      int i = left.x != 0u ? findLSB(left.x) : 32 + findLSB(left.y);
      left = left.x != 0u ? uvec2(left.x & (left.x - 1u), left.y) : uvec2(0u, left.y & (left.y - 1u));
      bool there = ps_face_planes(from, i, at, 0.0, planes);
      vec4 through = ps_face_through(from.first + i);
      // Faces of one sheet add up, sheets multiply.
      bool same = through.w == sheet.w;
      share *= same ? vec3(1.0) : mix(vec3(1.0), sheet.rgb, min(covered, 1.0));
      covered = (same ? covered : 0.0) + (there ? ps_face_covers(planes, place, side) : 0.0);
      sheet = through;
    }
    share *= mix(vec3(1.0), sheet.rgb, min(covered, 1.0));
    float weight = ps_face_weight(from, at, normal, place);
    sum += weight * share;
    total += weight;
  }
  return whole * sum / total;
}

#endif
