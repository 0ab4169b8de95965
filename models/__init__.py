"""Model descriptions (SDF), found through package.xml."""
