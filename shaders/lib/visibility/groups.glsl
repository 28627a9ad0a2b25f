// The groups of a pixel's sub-samples that are shaded together: three bits for each sub-sample in two words, the first ten
// in the first. The second word ends with the number of groups and the flags below.

#define PS_GROUPS 4  // of a pixel, at most
#define PS_NO_GROUP 7u  // nothing covers the sub-sample
#define PS_COUNT_SHIFT 21u
#define PS_UNIFORM 0x1000000u  // all sub-samples have one code
#define PS_OPEN 0x2000000u  // some sub-sample is not covered

uint ps_group(uvec2 codes, int sub_sample)
{
  return 7u & (sub_sample < 10 ? codes.x >> uint(3 * sub_sample) : codes.y >> uint(3 * (sub_sample - 10)));
}

uvec2 ps_with_group(uvec2 codes, int sub_sample, uint group)
{
  return sub_sample < 10 ? uvec2(codes.x | (group << uint(3 * sub_sample)), codes.y)
                         : uvec2(codes.x, codes.y | (group << uint(3 * (sub_sample - 10))));
}

#ifdef PS_MEMBER_BITS
// The cell of a sub-sample from the pixel's central one, out of words and not out of an array, for which compilers unroll
// loops over sub-samples: a software renderer would be busy with that for longer than with a picture.
ivec2 ps_sub_sample_cell(int sub_sample)
{
  return ivec2(ps_group(PS_MEMBER_COLUMNS, sub_sample), ps_group(PS_MEMBER_ROWS, sub_sample)) - PS_MEMBER_REACH;
}

// The sub-samples of one group that are still to be looked at: the lowest bit of each's three, in both words.
uvec2 ps_group_members(uvec2 codes, uint group)
{
  const uvec2 lowest = PS_MEMBER_BITS;
  uvec2 differ = codes ^ (lowest * group);
  return ~(differ | (differ >> 1u) | (differ >> 2u)) & lowest;
}

// Takes the first of the members out, and returns its cell from the pixel's central one, and its number. A software
// renderer goes through a loop over members as often as the largest group that it draws at once has some; through one over
// all sub-samples that picks them, as often as there are sub-samples.
ivec2 ps_next_member(inout uvec2 members, out int number)
{
  const uvec2 columns = PS_MEMBER_COLUMNS, rows = PS_MEMBER_ROWS;
  bool second = members.x == 0u;
  int bit = findLSB(second ? members.y : members.x);
  uvec2 at = (second ? uvec2(columns.y, rows.y) : uvec2(columns.x, rows.x)) >> uint(bit);
  members = second ? uvec2(0u, members.y & (members.y - 1u)) : uvec2(members.x & (members.x - 1u), members.y);
  number = bit / 3 + (second ? 10 : 0);
  return ivec2(at & 7u) - PS_MEMBER_REACH;
}

ivec2 ps_next_member(inout uvec2 members)
{
  int number;
  return ps_next_member(members, number);
}
#endif

int ps_group_count(uvec2 codes)
{
  return int((codes.y >> PS_COUNT_SHIFT) & 7u);
}

// Where groups lie in the list of all, of which a row has PS_LIST_MASK + 1. PS_PLACES: they are not listed in the order of
// their pixels.
#define PS_LIST_MASK 4095
#define PS_LIST_SHIFT 12

ivec2 ps_list_texel(int entry)
{
  return ivec2(entry & PS_LIST_MASK, entry >> PS_LIST_SHIFT);
}

#ifdef PS_PLACES
// `entry`: in the order of the pixels.
ivec2 ps_group_texel(int entry)
{
  return ps_list_texel(int(texelFetch(ps_places, ps_list_texel(entry), 0).x));
}
#else
ivec2 ps_group_texel(int entry)
{
  return ps_list_texel(entry);
}
#endif
