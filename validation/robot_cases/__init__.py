"""Sealed synthetic cases for the diagnosis of any robot: drawn, made, solved and scored."""
