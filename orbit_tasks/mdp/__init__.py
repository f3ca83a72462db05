"""Terms and scenery that several tasks of this package share."""
