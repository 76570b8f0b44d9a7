/* FMI 2.0 for co-simulation. */
#if defined FMI2_FUNCTION_PREFIX
#define FMI(name) FMI_EXPORT fmi_status FMI_PREFIXED(FMI2_FUNCTION_PREFIX, fmi2##name)
#define FMI_OTHER(kind, name) FMI_EXPORT kind FMI_PREFIXED(FMI2_FUNCTION_PREFIX, fmi2##name)
#else
#define FMI(name) FMI_EXPORT fmi_status fmi2##name
#define FMI_OTHER(kind, name) FMI_EXPORT kind fmi2##name
#endif
#define FMI_WHICH void *c, const unsigned int which[], size_t count

FMI_OTHER(const char *, GetTypesPlatform)(void) { return "default"; }
FMI_OTHER(const char *, GetVersion)(void) { return "2.0"; }
FMI(SetDebugLogging)(void *c, int on, size_t count, const char *const categories[])
{
    (void)on, (void)count, (void)categories;
    return c ? fmi_ok : fmi_error;
}

FMI_OTHER(void *, Instantiate)(const char *name, fmi_type type, const char *guid, const char *resources,
                               const fmi_callbacks *functions, int visible, int logging)
{
    (void)resources, (void)visible, (void)logging;
    if (!functions || type != FMI_COSIMULATION) return NULL;
    return fmi_make(name, guid, functions->componentEnvironment, functions->logger);
}
FMI_OTHER(void, FreeInstance)(void *c) { fmi_free((fmi_instance *)c); }

FMI(SetupExperiment)(void *c, int given, double tolerance, double start, int ends, double stop)
{
    (void)given, (void)tolerance, (void)ends, (void)stop;
    if (!c || ((fmi_instance *)c)->mode != FMI_MADE) return fmi_refuse((fmi_instance *)c, "It runs already.");
    ((fmi_instance *)c)->begun = start;
    return fmi_ok;
}
FMI(EnterInitializationMode)(void *c) { return fmi_enter((fmi_instance *)c, c ? ((fmi_instance *)c)->begun : 0.0); }
FMI(ExitInitializationMode)(void *c) { return fmi_leave((fmi_instance *)c); }
FMI(Terminate)(void *c) { return fmi_end((fmi_instance *)c); }
FMI(Reset)(void *c) { return fmi_reset((fmi_instance *)c); }

FMI(GetReal)(FMI_WHICH, double values[]) { return fmi_get((fmi_instance *)c, which, count, values); }
FMI(SetReal)(FMI_WHICH, const double values[]) { return fmi_set((fmi_instance *)c, which, count, values); }
#define FMI_ABSENT(name, kind) \
    FMI(Get##name)(FMI_WHICH, kind values[]) \
    { \
        (void)which, (void)values; \
        return fmi_none((fmi_instance *)c, count); \
    } \
    FMI(Set##name)(FMI_WHICH, kind const values[]) \
    { \
        (void)which, (void)values; \
        return fmi_none((fmi_instance *)c, count); \
    }
FMI_ABSENT(Integer, int)
FMI_ABSENT(Boolean, int)
FMI_ABSENT(String, const char *)

FMI(DoStep)(void *c, double at, double length, int kept)
{
    (void)at, (void)kept;
    return fmi_advance((fmi_instance *)c, length);
}
FMI(CancelStep)(void *c) { return fmi_lacks((fmi_instance *)c); }

/* A step is done when DoStep returns: nothing is ever pending. */
FMI(GetStatus)(void *c, const fmi_asked what, fmi_status *value)
{
    (void)c, (void)what, (void)value;
    return fmi_discard;
}
FMI(GetRealStatus)(void *c, const fmi_asked what, double *value)
{
    if (!c || what != FMI_LAST_TIME) return fmi_discard;
    *value = fmi_time((fmi_instance *)c);
    return fmi_ok;
}
FMI(GetIntegerStatus)(void *c, const fmi_asked what, int *value)
{
    (void)c, (void)what, (void)value;
    return fmi_discard;
}
FMI(GetBooleanStatus)(void *c, const fmi_asked what, int *value)
{
    if (!c || what != FMI_TERMINATED) return fmi_discard;
    *value = 0;
    return fmi_ok;
}
FMI(GetStringStatus)(void *c, const fmi_asked what, const char **value)
{
    (void)c, (void)what, (void)value;
    return fmi_discard;
}

FMI(SetRealInputDerivatives)(FMI_WHICH, const int order[], const double values[])
{
    (void)which, (void)order, (void)values;
    return count ? fmi_lacks((fmi_instance *)c) : fmi_ok;
}
FMI(GetRealOutputDerivatives)(FMI_WHICH, const int order[], double values[])
{
    (void)which, (void)order, (void)values;
    return count ? fmi_lacks((fmi_instance *)c) : fmi_ok;
}
FMI(GetFMUstate)(void *c, void **state) { return (void)state, fmi_lacks((fmi_instance *)c); }
FMI(SetFMUstate)(void *c, void *state) { return (void)state, fmi_lacks((fmi_instance *)c); }
FMI(FreeFMUstate)(void *c, void **state) { return (void)state, fmi_lacks((fmi_instance *)c); }
FMI(SerializedFMUstateSize)(void *c, void *state, size_t *size)
{
    return (void)state, (void)size, fmi_lacks((fmi_instance *)c);
}
FMI(SerializeFMUstate)(void *c, void *state, char bytes[], size_t size)
{
    return (void)state, (void)bytes, (void)size, fmi_lacks((fmi_instance *)c);
}
FMI(DeSerializeFMUstate)(void *c, const char bytes[], size_t size, void **state)
{
    return (void)bytes, (void)size, (void)state, fmi_lacks((fmi_instance *)c);
}
FMI(GetDirectionalDerivative)(void *c, const unsigned int unknowns[], size_t many, const unsigned int knowns[],
                              size_t count, const double seed[], double values[])
{
    (void)unknowns, (void)many, (void)knowns, (void)count, (void)seed, (void)values;
    return fmi_lacks((fmi_instance *)c);
}
