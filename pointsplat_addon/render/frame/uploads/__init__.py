"""What a frame needs on the device beside its targets: a module for each kind of upload, and their coordinator."""
