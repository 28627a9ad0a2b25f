// Irradiance from rectangles and ellipses: Lambert's formula, and sums over narrowed beams. For lights.glsl.

#ifdef PS_HAS_AREA_LIGHTS

// Lengths in units of the largest of them: irradiance depends on angles alone, and the fourth powers of lengths below
// 1e-9 or above 1e9 leave float's range.
struct PsArea {
  vec3 offset;  // from the surface to the centre
  vec3 direction;
  vec3 axis_u;
  vec3 axis_v;
  vec2 extent;  // lengths of the axes
  float limit;  // tangent of half the beam's angle
  float beam;  // 1 / mean of the beam over the flux; 0: not narrowed
};

PsArea ps_area(int index, vec3 offset)
{
  vec4 direction = ps_light(index, 2), axis_u = ps_light(index, 3), axis_v = ps_light(index, 4);
#ifdef PS_HAS_BEAMS
  float limit = ps_light(index, 5).x;
#else
  float limit = 0.0;
#endif
  vec3 size = abs(offset);
  float unit = 1.0 / max(max(max(size.x, size.y), size.z), max(axis_u.w, axis_v.w));
  return PsArea(offset * unit, direction.xyz, axis_u.xyz * unit, axis_v.xyz * unit,
                vec2(axis_u.w, axis_v.w) * unit, limit, direction.w);
}

// Twice what the edge from a to b adds to Lambert's formula: the angle between them times the component along the
// normal of the unit vector perpendicular to both.
float ps_edge(vec3 a, vec3 b, vec3 normal)
{
  float scale = inversesqrt(max(dot(a, a) * dot(b, b), 1e-30));
  float cosine = clamp(dot(a, b) * scale, -1.0, 1.0);
  // angle / sine for an acute angle: a rational fit, exact to 6e-7.
  float x = abs(cosine);
  float acute = (1.570795 + (0.9058155 + 0.02603237 * x) * x) / (1.0 + (1.21324 + 0.2894018 * x) * x);
  // The sine by the product, whose rounding is then in both: near the edge 1 - x * x is nothing but rounding.
  vec3 across = scale * cross(a, b);
  float ratio = cosine < 0.0 ? PS_PI * inversesqrt(max(dot(across, across), 1e-30)) - acute : acute;
  return ratio * dot(across, normal);
}

// Lambert's formula, cut by the horizon: a convex polygon leaves and enters the upper side at most once.
struct PsPolygon {
  float total;
  vec3 leaving;
  vec3 entering;
};

void ps_add_edge(inout PsPolygon polygon, vec3 a, vec3 b, vec3 normal)
{
  float above = dot(a, normal), below = dot(b, normal);
  float gap = above - below;
  vec3 crossing = mix(a, b, clamp(above / (gap == 0.0 ? 1.0 : gap), 0.0, 1.0));
  bool enters = above <= 0.0 && below > 0.0, leaves = above > 0.0 && below <= 0.0;
  polygon.entering = enters ? crossing : polygon.entering;
  polygon.leaving = leaves ? crossing : polygon.leaving;
  float edge = ps_edge(enters ? crossing : a, leaves ? crossing : b, normal);
  polygon.total += above > 0.0 || below > 0.0 ? edge : 0.0;
}

float ps_polygon_irradiance(PsPolygon polygon, vec3 normal)
{
  return 0.5 * abs(polygon.total + ps_edge(polygon.leaving, polygon.entering, normal));
}

float ps_rectangle_irradiance(PsArea area, vec3 normal)
{
  vec3 a = area.offset - area.axis_u - area.axis_v, b = area.offset + area.axis_u - area.axis_v;
  vec3 c = area.offset + area.axis_u + area.axis_v, d = area.offset - area.axis_u + area.axis_v;
  PsPolygon polygon = PsPolygon(0.0, vec3(0.0), vec3(0.0));
  ps_add_edge(polygon, a, b, normal);
  ps_add_edge(polygon, b, c, normal);
  ps_add_edge(polygon, c, d, normal);
  ps_add_edge(polygon, d, a, normal);
  return ps_polygon_irradiance(polygon, normal);
}

// The ellipse is replaced by a regular polygon of equal area.
float ps_ellipse_irradiance(PsArea area, vec3 normal)
{
  const float angle = 2.0 * PS_PI / float(PS_ELLIPSE_SIDES);
  float sine = sin(angle), cosine = cos(angle);
  vec2 at = vec2(sqrt(angle / sine), 0.0);
  vec3 a = area.offset + at.x * area.axis_u;
  PsPolygon polygon = PsPolygon(0.0, vec3(0.0), vec3(0.0));
  for (int i = 0; i < PS_ELLIPSE_SIDES; i++) {
    at = vec2(cosine * at.x - sine * at.y, sine * at.x + cosine * at.y);
    vec3 b = area.offset + at.x * area.axis_u + at.y * area.axis_v;
    ps_add_edge(polygon, a, b, normal);
    a = b;
  }
  return ps_polygon_irradiance(polygon, normal);
}

// The share of an area light's radiance that leaves it at an angle from its normal: Blender's soft-box grid.
float ps_beam(PsArea area, float cosine)
{
#ifdef PS_HAS_BEAMS
  float tangent = sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-6);
  return area.beam == 0.0 ? 1.0 : max(area.limit - tangent, 0.0) * area.beam;
#else
  return 1.0;
#endif
}

#ifdef PS_HAS_BEAMS

// Irradiance from a light whose beam is narrowed: a sum over a grid on the part of it that can shine here. Rows of an ellipse
// lie at even angles, and are as long as its chords, so that they have its area.
float ps_beam_irradiance(PsArea area, float height, bool ellipse, vec3 normal)
{
  vec3 unit_u = area.axis_u / area.extent.x, unit_v = area.axis_v / area.extent.y;
  vec2 foot = -vec2(dot(area.offset, unit_u), dot(area.offset, unit_v));
  float extent = height * area.limit;
  vec2 low = max(foot - extent, -area.extent), high = min(foot + extent, area.extent);
  vec2 ends = ellipse ? asin(clamp(vec2(low.y, high.y) / area.extent.y, -1.0, 1.0)) : vec2(low.y, high.y);
  float between = max(ends.y - ends.x, 0.0) / float(PS_SPREAD_CELLS);
  int rows = area.beam == 0.0 || between * max(high.x - low.x, 0.0) == 0.0 ? 0 : PS_SPREAD_CELLS;
  float total = 0.0;
  for (int row = 0; row < rows; row++) {
    float place = ends.x + between * (float(row) + 0.5), chord = ellipse ? cos(place) : 1.0;
    float left = max(low.x, -chord * area.extent.x), right = min(high.x, chord * area.extent.x);
    float width = max(right - left, 0.0) / float(PS_SPREAD_CELLS), of_row = 0.0;
    vec2 at = vec2(left + 0.5 * width, ellipse ? area.extent.y * sin(place) : place);
    for (int column = 0; column < PS_SPREAD_CELLS; column++) {
      vec3 to_light = area.offset + at.x * unit_u + at.y * unit_v;
      float inverse = inversesqrt(dot(to_light, to_light));
      float cosine = max(dot(to_light, normal), 0.0) * inverse;
      of_row += ps_beam(area, height * inverse) * cosine * height * inverse * inverse * inverse;
      at.x += width;
    }
    total += of_row * width * (ellipse ? area.extent.y * chord : 1.0);
  }
  return total * between;
}

#endif

#endif
