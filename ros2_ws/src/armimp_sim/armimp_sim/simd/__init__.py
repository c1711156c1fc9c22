"""Arithmetic that the compiler turns into SIMD instructions."""
