"""The live view of the bench. No command ever waits for a viewer."""
