// Real spherical harmonics of degrees 0 to 4, with the order and the signs of Kerbl et al. 2023. Texels of a splat: its
// coefficients of the three channels one after the other, degree 0 first, PS_SH_TEXELS of them.

vec4 ps_coefficients(int splat, int i)
{
  int at = splat * PS_SH_TEXELS + i;
  return i < PS_SH_TEXELS ? texelFetch(ps_harmonics, ivec2(at & PS_SH_MASK, at >> PS_SH_SHIFT), 0) : vec4(0.0);
}

// Of four functions with the values b, from the one of index 4 * four on.
vec3 ps_four(int splat, int four, vec4 b)
{
  vec4 l = ps_coefficients(splat, 3 * four), m = ps_coefficients(splat, 3 * four + 1);
  vec4 n = ps_coefficients(splat, 3 * four + 2);
  return b.x * l.xyz + b.y * vec3(l.w, m.xy) + b.z * vec3(m.zw, n.x) + b.w * n.yzw;
}

// The sum of all functions along a unit direction.
vec3 ps_harmonic_sum(int splat, vec3 d)
{
#if PS_SH_TEXELS == 1
  return 0.28209479177387814 * ps_coefficients(splat, 0).xyz;
#else
  float x = d.x, y = d.y, z = d.z;
  vec3 sum = ps_four(splat, 0, vec4(0.28209479177387814, 0.4886025119029199 * vec3(-y, z, -x)));
#endif
#if PS_SH_TEXELS > 3
  float xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
  sum += ps_four(splat, 1, vec4(1.0925484305920792 * vec2(xy, -yz), 0.31539156525252005 * (2.0 * zz - xx - yy),
                                -1.0925484305920792 * xz));
  float last = 0.5462742152960396 * (xx - yy);
#if PS_SH_TEXELS == 7
  sum += last * ps_coefficients(splat, 6).xyz;
#else
  sum += ps_four(splat, 2, vec4(last, -0.5900435899266435 * y * (3.0 * xx - yy), 2.890611442640554 * xy * z,
                                -0.4570457994644658 * y * (4.0 * zz - xx - yy)));
  sum += ps_four(splat, 3, vec4(0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                                -0.4570457994644658 * x * (4.0 * zz - xx - yy), 1.445305721320277 * z * (xx - yy),
                                -0.5900435899266435 * x * (xx - 3.0 * yy)));
#endif
#endif
#if PS_SH_TEXELS > 12
  sum += ps_four(splat, 4, vec4(2.5033429417967046 * xy * (xx - yy), -1.7701307697799304 * yz * (3.0 * xx - yy),
                                0.9461746957575601 * xy * (7.0 * zz - 1.0), -0.6690465435572892 * yz * (7.0 * zz - 3.0)));
  sum += ps_four(splat, 5, vec4(0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0),
                                -0.6690465435572892 * xz * (7.0 * zz - 3.0),
                                0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0),
                                -1.7701307697799304 * xz * (xx - 3.0 * yy)));
  sum += 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)) * ps_coefficients(splat, 18).xyz;
#endif
#if PS_SH_TEXELS > 1
  return sum;
#endif
}
