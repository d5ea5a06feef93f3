"""Hand labels made in all views at once: proposals, suggestions, what cameras see of boxes, agreement, exports."""
