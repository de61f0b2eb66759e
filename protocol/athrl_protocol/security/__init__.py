"""Certificates and access lists."""
