void main() {
  color = u.color;
}
