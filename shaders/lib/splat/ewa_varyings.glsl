// What both vertex shaders of EWA hand on of a projected splat. Layout: render/passes/ewa/ewa.py.

// Where the projected splat is that is drawn as the number `index`.
ivec2 ps_listed(int index)
{
  return ivec2(texelFetch(ps_list, ivec2(index & 4095, index >> 12), 0).xy);
}

// Sets the varyings; the covariance of what is drawn of it: PS_BLEND its kernel, else the ellipse.
vec3 ps_splat(ivec2 at, vec4 centre)
{
  vec4 shape = texelFetch(ps_splat_shape, at, 0);
  vec3 c = shape.xyz;
  float of = c.x * c.z - c.y * c.y;
#ifdef PS_BLEND
  c.xz += u.low_pass;
#else
  float middle = 0.5 * (c.x + c.z), least = middle - length(vec2(0.5 * (c.x - c.z), c.y));
  c.xz += max(max(PS_EWA_LEAST, PS_EWA_THINNEST * middle) - least, 0.0);
#endif
  float with = c.x * c.z - c.y * c.y;
  v_centre = vec4(centre.xy + u.principal_point, centre.z, sign(centre.w));
  v_front = texelFetch(ps_splat_front, at, 0);
#ifdef PS_BLEND
  v_conic = vec4(vec3(c.z, -c.y, c.x) / with, ps_ewa_peak(v_front.z, of, with));
#else
  v_conic = vec4(vec3(c.z, -c.y, c.x) / with, ps_ewa_rim(v_front.z));
#endif
  v_material = vec4(shape.w, float((int(abs(centre.w)) - 1) >> 1), sqrt(c.xz));
#ifdef PS_BLEND
#ifdef PS_NORMAL
  v_normal = texelFetch(ps_splat_normal, at, 0);
#endif
#ifdef PS_COLOR
  v_color = texelFetch(ps_splat_color, at, 0);
#endif
#ifdef PS_EMISSION
  v_emission = texelFetch(ps_splat_emission, at, 0);
#endif
#ifdef PS_VELOCITY
  v_velocity = texelFetch(ps_splat_velocity, at, 0);
#endif
#endif
  return c;
}
