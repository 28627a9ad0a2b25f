"""What is made once and used again: on the processor by content, and on the device from frame to frame."""
