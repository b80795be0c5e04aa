"""What is measured as tables and streams: finger opening, force, the tool's tip, clocks."""
