// Index of a compute invocation. Work groups may be laid out in rows, and the last row may be longer
// than what was asked for: compare the index with the number of elements before using it.
int ps_index() {
  uint group = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
  return int(group * gl_WorkGroupSize.x + gl_LocalInvocationID.x);
}
