/* The instance, its variables and its steps: what both versions of the standard need. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32 || defined __CYGWIN__
#define FMI_EXPORT __declspec(dllexport)
#elif defined __GNUC__
#define FMI_EXPORT __attribute__((visibility("default")))
#else
#define FMI_EXPORT
#endif
#define FMI_PASTED(a, b) a##b
#define FMI_PREFIXED(prefix, name) FMI_PASTED(prefix, name)

enum { FMI_MADE, FMI_STARTING, FMI_RUNNING, FMI_ENDED, FMI_FAILED };

typedef struct {
    double value[FMI_COUNT];
    fmi_memory past; /* before the current sample */
    fmi_memory shown; /* where an output is computed ahead */
    double output; /* at the current time, once it runs */
    double begun; /* time at the first sample */
    unsigned long samples;
    int mode;
    void *environment;
    fmi_log log;
    char *name;
} fmi_instance;

static fmi_status fmi_refuse(fmi_instance *of, const char *message)
{
    if (of && of->log) fmi_say(of, message);
    return fmi_error;
}

static double fmi_time(const fmi_instance *of)
{
    return of->begun + (double)of->samples * FMI_TS;
}

static void fmi_clear(fmi_instance *of)
{
    memcpy(of->value, fmi_first, sizeof of->value);
    of->begun = 0.0;
    of->samples = 0;
    of->mode = FMI_MADE;
}

static fmi_instance *fmi_make(const char *name, const char *token, void *environment, fmi_log log)
{
    fmi_instance *of = (fmi_instance *)calloc(1, sizeof(fmi_instance));
    if (!of) return NULL;
    of->environment = environment;
    of->log = log;
    of->name = (char *)calloc(1, (name ? strlen(name) : 0) + 1);
    if (of->name && name) strcpy(of->name, name);
    if (!of->name || !token || strcmp(token, FMI_TOKEN) != 0) {
        fmi_refuse(of, "The token is not that of this FMU: description and binary do not belong together.");
        free(of->name);
        free(of);
        return NULL;
    }
    fmi_clear(of);
    return of;
}

static void fmi_free(fmi_instance *of)
{
    if (!of) return;
    free(of->name);
    free(of);
}

static fmi_status fmi_enter(fmi_instance *of, double start)
{
    if (!of || of->mode != FMI_MADE) return fmi_refuse(of, "Initialization has its place before the first step.");
    of->begun = start;
    of->mode = FMI_STARTING;
    return fmi_ok;
}

/* The output at the current time, from the inputs as they are now; the past stays as it is. */
static double fmi_ahead(fmi_instance *of)
{
    if (of->mode < FMI_RUNNING) fmi_begin(&of->shown, of->value, of->begun);
    else of->shown = of->past;
    return fmi_next(&of->shown, of->value, fmi_time(of));
}

static fmi_status fmi_leave(fmi_instance *of)
{
    if (!of || of->mode != FMI_STARTING) return fmi_refuse(of, "There is no initialization to leave.");
    of->output = fmi_ahead(of);
    fmi_begin(&of->past, of->value, of->begun);
    of->mode = FMI_RUNNING;
    return fmi_ok;
}

static fmi_status fmi_end(fmi_instance *of)
{
    if (!of || of->mode != FMI_RUNNING) return fmi_refuse(of, "Nothing runs that could be terminated.");
    of->mode = FMI_ENDED;
    return fmi_ok;
}

static fmi_status fmi_reset(fmi_instance *of)
{
    if (!of) return fmi_error;
    fmi_clear(of);
    return fmi_ok;
}

static fmi_status fmi_get(fmi_instance *of, const unsigned int which[], size_t count, double values[])
{
    for (size_t i = 0; i < count; i++) {
        if (!of || which[i] >= FMI_COUNT) return fmi_refuse(of, "There is no such variable.");
        if (fmi_kind[which[i]] == 't') values[i] = fmi_time(of);
        else if (fmi_kind[which[i]] == 'o') values[i] = of->mode < FMI_RUNNING ? fmi_ahead(of) : of->output;
        else values[i] = of->value[which[i]];
        if (!isfinite(values[i])) return fmi_refuse(of, "The output is not a finite number.");
    }
    return fmi_ok;
}

static fmi_status fmi_set(fmi_instance *of, const unsigned int which[], size_t count, const double values[])
{
    for (size_t i = 0; i < count; i++) {
        if (!of || which[i] >= FMI_COUNT) return fmi_refuse(of, "There is no such variable.");
        if (fmi_kind[which[i]] == 't' || fmi_kind[which[i]] == 'o')
            return fmi_refuse(of, "Time and the output cannot be set.");
        if (fmi_kind[which[i]] == 'r' && of->mode >= FMI_RUNNING)
            return fmi_refuse(of, "A value at rest can be set before the first step only.");
        if (!isfinite(values[i])) return fmi_refuse(of, "A value that is set is not a finite number.");
        of->value[which[i]] = values[i];
    }
    return fmi_ok;
}

static fmi_status fmi_advance(fmi_instance *of, double length)
{
    char message[160];
    const double count = floor(length / FMI_TS + 0.5);
    if (!of || of->mode != FMI_RUNNING) return fmi_refuse(of, "A step needs an initialized instance.");
    if (!(count >= 1.0 && count <= 1e9) || !(fabs(length - count * FMI_TS) <= 1e-6 * FMI_TS + 1e-15 * fabs(fmi_time(of)))) {
        snprintf(message, sizeof message, "A step of %.10g s is no multiple of the sampling time %.10g s.", length, FMI_TS);
        return fmi_refuse(of, message);
    }
    for (double i = 0.0; i < count; i += 1.0) {
        of->output = fmi_next(&of->past, of->value, fmi_time(of));
        if (!isfinite(of->output)) {
            of->mode = FMI_FAILED;
            snprintf(message, sizeof message, "The run has left the finite numbers at %.10g s.", fmi_time(of));
            return fmi_refuse(of, message);
        }
        of->samples++;
    }
    /* What answers the inputs at once is late: those at the end of the step are not yet known. */
    if (!FMI_LATE) of->output = fmi_ahead(of);
    return fmi_ok;
}

static fmi_status fmi_none(fmi_instance *of, size_t count)
{
    return count ? fmi_refuse(of, "All variables are real numbers.") : fmi_ok;
}

static fmi_status fmi_lacks(fmi_instance *of)
{
    return fmi_refuse(of, "The description says that this FMU cannot do that.");
}
