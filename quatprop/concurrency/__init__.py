"""Work side by side: in threads of this process, and in processes of this machine."""
