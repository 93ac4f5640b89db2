"""quatprop turns recorded gyroscope logs into attitude."""
