"""Liquids as weakly compressible particles."""
