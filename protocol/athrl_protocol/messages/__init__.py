"""Messages: the schema and its version, chunks, frames, keys, and size limits."""
