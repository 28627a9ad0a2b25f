"""One image: its samples drawn, averaged, presented and read back."""
