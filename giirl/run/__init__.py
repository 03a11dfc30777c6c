"""One run: its folder, demonstrations, training in each runtime, and evaluation."""
