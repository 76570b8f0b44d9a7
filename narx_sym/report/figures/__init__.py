"""Pictures: `describe` says what one is made of and how it looks; `still` and `zoomed` draw it, and know no meaning."""
