// Mean radiance at places in media, but for that of lamps: between the middles of blocks, whose
// fourth roots are kept (core/indirect/media.py). Layout of ps_medium_light_of:
// render/indirect/media.py, PS_MEDIA_WIDTH blocks in a row of the texture.

vec3 ps_light_of_block(ivec3 at)
{
  int number = at.x + u.medium_blocks.x * (at.y + u.medium_blocks.y * at.z);
  return texelFetch(ps_medium_light_of, ivec2(number & (PS_MEDIA_WIDTH - 1), number / PS_MEDIA_WIDTH), 0).rgb;
}

// position: in view space.
vec3 ps_medium_light(vec3 position)
{
  ivec3 last = u.medium_blocks.xyz - 1;
  vec3 in_blocks = (u.blocks_from_view * vec4(position, 1.0)).xyz;
  vec3 at = clamp(in_blocks - 0.5, vec3(0.0), vec3(last)), share = fract(at);
  ivec3 first = ivec3(floor(at));
  vec3 found = vec3(0.0);
  for (int corner = 0; corner < 8; corner++) {
    ivec3 step_to = ivec3(corner & 1, corner >> 1 & 1, corner >> 2);
    vec3 weight = mix(1.0 - share, share, vec3(step_to));
    found += weight.x * weight.y * weight.z * ps_light_of_block(min(first + step_to, last));
  }
  // What light does not look at, as diffuse rays do not look at it, has no block there.
  bool within = all(greaterThan(in_blocks, vec3(-1.0))) && all(lessThan(in_blocks, vec3(last) + 2.0));
  return within ? found * found * found * found : ps_ambient();
}
