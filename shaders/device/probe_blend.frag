// Asks a device whether it adds into a target of floats: the value is too large for any other format.
void main() {
  color = vec4(100000.25);
}
