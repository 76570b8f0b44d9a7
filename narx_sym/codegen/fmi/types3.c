/* The types of FMI 3.0 that its functions have. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum { fmi_ok, fmi_warning, fmi_discard, fmi_error, fmi_fatal } fmi_status;
typedef enum { fmi_independent, fmi_constant, fmi_fixed, fmi_tunable, fmi_discrete, fmi_dependent } fmi_dependency;
typedef enum { fmi_unknown, fmi_unchanged, fmi_changed } fmi_qualifier;
typedef void (*fmi_log)(void *environment, fmi_status status, const char *category, const char *message);
typedef void (*fmi_clocked)(void *environment);
typedef void (*fmi_lock)();
typedef void (*fmi_intermediate)(void *environment, double time, bool set, bool get, bool finished, bool early,
                                 bool *asked, double *returned);
/* End of the types. */

#define fmi_say(of, text) (of)->log((of)->environment, fmi_error, "logStatusError", text)
