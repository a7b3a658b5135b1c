"""Planning loss, epistemic uncertainty, the iRprop- search, sessions."""
