"""Session folders: write and read the data of every lift and pose."""
