"""Single contacts: asked for and given; what to paste into a scene. Imports `engines` and below."""
