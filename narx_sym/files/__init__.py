"""What is kept on disk: atomic writes, model files, the journal of long work, parallel loops."""
