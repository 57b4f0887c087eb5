// One processing element: a core and what every environment needs around it, which is self-reset,
// the two reset modes, the count of elapsed steps and the time limit.
//
// Inputs come with valid_i, elapsed_i LATENCY - 1 cycles later, results LATENCY cycles later.
module pearl_pe
  import pearl_pkg::*;
  import pearl_core_pkg::*;
(
    input logic                           clk_i,
    input logic                           rst_ni,
    input logic                           valid_i,
    input mode_t                          mode_i,
    input logic  [ELAPSED_BITS-1:0]       max_cycles_i,
    input logic  [  STATE_BITS-1:0]       state_i,
    // {truncated, terminated} of the slot's previous step.
    input logic  [    TER_BITS-1:0]       ter_i,
    input logic  [  STATE_BITS-1:0]       init_i,
    input logic                           reset_i,
    input logic  [ ACTION_BITS-1:0]       action_i,
    input logic  [   RNG_WORDS-1:0][31:0] rng_i,

    input  logic [ELAPSED_BITS-1:0] elapsed_i,
    output logic [ELAPSED_BITS-1:0] elapsed_o,

    output logic                   valid_o,
    output logic [ STATE_BITS-1:0] state_o,
    output logic [   OBS_BITS-1:0] obs_o,
    output logic [REWARD_BITS-1:0] reward_o,
    output logic [   TER_BITS-1:0] ter_o
);

  logic named, ended, first, hold;
  assign named = mode_i.reset_all || (mode_i.reset_mask && reset_i);
  assign ended = ter_i != '0;
  assign first = named || ended;
  assign hold  = mode_i.next_step && ended && !named;

  logic terminated;
  logic [REWARD_BITS-1:0] reward;
  // A stored start state replaces the current one here, so a core knows of one kind of start only.
  pearl_core u_core (
      .clk_i,
      .rst_ni,
      .valid_i,
      .first_i(first && !mode_i.stored),
      .hold_i(hold),
      .state_i(first && mode_i.stored ? init_i : state_i),
      .action_i,
      .rng_i,
      .valid_o,
      .state_o,
      .obs_o,
      .reward_o(reward),
      .terminated_o(terminated)
  );

  // The counter is read, raised and written in the core's last cycle, which spares the pipeline
  // from carrying it along.
  logic first_late, hold_late, hold_q, truncated_q;
  pearl_delay #(
      .WIDTH (2),
      .STAGES(LATENCY - 1)
  ) u_delay (
      .clk_i,
      .d_i({first, hold}),
      .d_o({first_late, hold_late})
  );
  // The first step of an episode overrules the sum and the comparison instead of clearing what they
  // start from: a mask in front of them would cost a LUT a bit more. Who is held is at a first step.
  assign elapsed_o = first_late ? ELAPSED_BITS'(!hold_late) : elapsed_i + 1'b1;

  always_ff @(posedge clk_i) begin
    hold_q <= hold_late;
    truncated_q <= !hold_late && max_cycles_i != '0 &&
        (first_late ? max_cycles_i == ELAPSED_BITS'(1) : elapsed_i >= max_cycles_i - 1'b1);
  end

  assign reward_o = hold_q ? '0 : reward;
  assign ter_o = {truncated_q, terminated && !hold_q};

endmodule
