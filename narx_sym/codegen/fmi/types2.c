/* The types of FMI 2.0 that its functions have. */
#include <stddef.h>

typedef enum { fmi_ok, fmi_warning, fmi_discard, fmi_error, fmi_fatal, fmi_pending } fmi_status;
typedef enum { FMI_EXCHANGE, FMI_COSIMULATION } fmi_type;
typedef enum { FMI_STEP_STATUS, FMI_PENDING_STATUS, FMI_LAST_TIME, FMI_TERMINATED } fmi_asked;
typedef void (*fmi_log)(void *environment, const char *name, fmi_status status, const char *category,
                        const char *message, ...);
typedef struct {
    fmi_log logger;
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *memory);
    void (*stepFinished)(void *environment, fmi_status status);
    void *componentEnvironment;
} fmi_callbacks;
/* End of the types. */

#define fmi_say(of, text) (of)->log((of)->environment, (of)->name, fmi_error, "logStatusError", text)
