// The core of MountainCar: step.py in hardware, with its names. Pipelined, a slot a cycle.

// verilator lint_off DECLFILENAME
package mountain_car_pkg;
  // verilator lint_on DECLFILENAME

  import pearl_fixed_pkg::*;

  // Start, turns | cosine | slope | velocity | position | what stops the car or ends the episode.
  localparam int unsigned LATENCY = 3 * MULTIPLY_LATENCY + SINE_COSINE_LATENCY + 3;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 64;
  localparam int unsigned ACTION_BITS = 2;
  localparam int unsigned OBS_BITS = 64;
  localparam int unsigned REWARD_BITS = 1;

  // A state word, the first field of the spec last.
  typedef struct packed {
    fixed_t velocity;
    fixed_t position;
  } state_t;

endpackage

module mountain_car_pe
  import mountain_car_pkg::*;
  import pearl_fixed_pkg::*;
#(
    // `goal_word` of step.py: the least velocity with which the goal counts as reached.
    parameter fixed_t GOAL_VELOCITY = '0
) (
    input logic               clk_i,
    input logic               rst_ni,
    input logic               valid_i,
    // Start from the initial state, not from state_i.
    input logic               first_i,
    // Do not step: the result is the state started from and its observation.
    input logic               hold_i,
    input state_t             state_i,
    input logic   [1:0]       action_i,
    // The random draws of this slot and step, those for the initial state first.
    input logic   [0:0][31:0] rng_i,

    output logic          valid_o,
    output state_t        state_o,
    output logic   [63:0] obs_o,
    output logic          reward_o,
    output logic          terminated_o
);

  // The constants of step.py.
  localparam fixed_t LEFT_END = -32'sd1288490189;
  localparam fixed_t RIGHT_END = 32'sd644245094;
  localparam fixed_t GOAL = 32'sd536870912;
  localparam fixed_t MAX_SPEED = 32'sd75161928;
  localparam fixed_t FORCE = 32'sd1073742;
  localparam fixed_t GRAVITY = 32'sd1374389535;
  localparam fixed_t TURNS = 32'sd2050695827;
  localparam fixed_t MIDDLE = -32'sd536870912;
  localparam fixed_t START = 32'sd214748364;

  // Cycles after the inputs at which things are known.
  localparam int unsigned AT_FROM = MULTIPLY_LATENCY;
  localparam int unsigned AT_COSINE = AT_FROM + MULTIPLY_LATENCY + SINE_COSINE_LATENCY;
  localparam int unsigned AT_SLOPE = AT_COSINE + MULTIPLY_LATENCY;

  logic [LATENCY-1:0] valid_q;
  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end

  // Where the slot starts from.
  state_t state, from, from_late;
  fixed_t start;
  logic first, hold, hold_late;
  logic [1:0] action;

  pearl_fixed_multiply #(
      .SHIFT (32),
      .ADDEND(MIDDLE)
  ) u_start (
      .clk_i,
      .a_i(rng_i[0]),
      .b_i(START),
      .product_o(start)
  );
  pearl_delay #(
      .WIDTH (STATE_BITS + 2),
      .STAGES(AT_FROM)
  ) u_state (
      .clk_i,
      .d_i({first_i, hold_i, state_i}),
      .d_o({first, hold, state})
  );
  assign from = first ? state_t'{velocity: '0, position: start} : state;

  pearl_delay #(
      .WIDTH (STATE_BITS + 1),
      .STAGES(AT_SLOPE - AT_FROM)
  ) u_from (
      .clk_i,
      .d_i({hold, from}),
      .d_o({hold_late, from_late})
  );
  pearl_delay #(
      .WIDTH (2),
      .STAGES(AT_SLOPE)
  ) u_action (
      .clk_i,
      .d_i(action_i),
      .d_o(action)
  );

  // How steep the hill is here.
  fixed_t turns, cosine, unused_sine, slope;

  pearl_fixed_multiply #(
      .SHIFT(30)
  ) u_turns (
      .clk_i,
      .a_i(from.position),
      .b_i(TURNS),
      .product_o(turns)
  );
  pearl_sine_cosine u_cosine (
      .clk_i,
      .turns_i (turns),
      .sine_o  (unused_sine),
      .cosine_o(cosine)
  );
  pearl_fixed_multiply #(
      .SHIFT(39)
  ) u_slope (
      .clk_i,
      .a_i(cosine),
      .b_i(GRAVITY),
      .product_o(slope)
  );

  // The next velocity, then the next position, then what comes of both.
  fixed_t push;
  logic signed [33:0] velocity_d;
  logic signed [32:0] position_d;
  fixed_t velocity_q, position_late_q, position_q, velocity_late_q;
  logic hold_q, hold_late_q;
  state_t after_q;
  logic stopped, terminated_q;

  always_comb begin
    unique case (action)
      2'd0: push = -FORCE;
      2'd1: push = '0;
      2'd2: push = FORCE;
      2'd3: push = 2 * FORCE;
    endcase
  end
  assign velocity_d = 34'(from_late.velocity) + 34'(push) - 34'(slope);
  assign position_d = 33'(position_late_q) + 33'(velocity_q);
  assign stopped = !hold_late_q && position_q == LEFT_END && velocity_late_q[31];

  always_ff @(posedge clk_i) begin
    hold_q <= hold_late;
    position_late_q <= from_late.position;
    if (hold_late) velocity_q <= from_late.velocity;
    else if (velocity_d > 34'(MAX_SPEED)) velocity_q <= MAX_SPEED;
    else if (velocity_d < -34'(MAX_SPEED)) velocity_q <= -MAX_SPEED;
    else velocity_q <= velocity_d[31:0];

    hold_late_q <= hold_q;
    velocity_late_q <= velocity_q;
    if (hold_q) position_q <= position_late_q;
    else if (position_d < 33'(LEFT_END)) position_q <= LEFT_END;
    else if (position_d > 33'(RIGHT_END)) position_q <= RIGHT_END;
    else position_q <= position_d[31:0];

    after_q.position <= position_q;
    after_q.velocity <= stopped ? '0 : velocity_late_q;
    terminated_q <= position_q >= GOAL && velocity_late_q >= GOAL_VELOCITY;
  end

  assign valid_o = valid_q[LATENCY-1];
  assign state_o = after_q;
  assign obs_o = after_q;
  assign reward_o = 1'b0;
  assign terminated_o = terminated_q;

endmodule
