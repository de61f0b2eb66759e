"""Chunks and their images as bytes."""
