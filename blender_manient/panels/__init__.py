"""What the sidebar's two tabs and the preferences show, a section a file, in the order of `bl_order`. A line
here draws what other rooms know; what is changed, the operators behind its buttons change."""
