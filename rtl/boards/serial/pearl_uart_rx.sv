// SPDX-License-Identifier: MIT
// Bytes from a serial line: a start bit, eight data bits, the lowest first, and a stop bit.
module pearl_uart_rx #(
    parameter int unsigned CLOCKS_PER_BIT = 15
) (
    input  logic       clk_i,
    input  logic       rst_ni,
    input  logic       rx_i,
    // For one cycle a byte.
    output logic       valid_o,
    output logic [7:0] data_o,
    // The line was low where a stop bit has to be, and has been ever since.
    output logic       break_o
);

  if (CLOCKS_PER_BIT < 4) begin : gen_illegal_clocks
    $error("CLOCKS_PER_BIT is %0d; it takes 4 to find the middle of a bit", CLOCKS_PER_BIT);
  end

  localparam int unsigned TIMER_BITS = $clog2(CLOCKS_PER_BIT);
  // The synchroniser delays the line by two cycles, and a cycle passes before the timer starts.
  localparam int unsigned TO_MIDDLE = CLOCKS_PER_BIT / 2 - 1;
  localparam logic [3:0] STOP = 4'd9;

  typedef enum logic [1:0] {
    Idle,
    Receive,
    Broken
  } state_e;

  state_e state_q;
  (* ASYNC_REG = "TRUE" *) logic [1:0] rx_q;
  logic [TIMER_BITS-1:0] timer_q;
  // Which bit is received: 0 is the start bit.
  logic [3:0] bit_q;
  logic [7:0] data_q;

  logic line, sample;
  assign line   = rx_q[1];
  assign sample = state_q == Receive && timer_q == '0;

  always_ff @(posedge clk_i) rx_q <= {rx_q[0], rx_i};

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      state_q <= Idle;
    end else begin
      unique case (state_q)
        Idle: if (!line) state_q <= Receive;
        Receive: begin
          // A start bit that is over in its middle was none.
          if (sample && bit_q == '0 && line) state_q <= Idle;
          if (sample && bit_q == STOP) state_q <= line ? Idle : Broken;
        end
        Broken: if (line) state_q <= Idle;
        default: state_q <= Idle;
      endcase
    end
  end

  always_ff @(posedge clk_i) begin
    if (state_q == Idle) begin
      timer_q <= TIMER_BITS'(TO_MIDDLE);
      bit_q   <= '0;
    end else if (sample) begin
      timer_q <= TIMER_BITS'(CLOCKS_PER_BIT - 1);
      bit_q   <= bit_q + 1'b1;
      if (bit_q != STOP) data_q <= {line, data_q[7:1]};
    end else begin
      timer_q <= timer_q - 1'b1;
    end
  end

  assign valid_o = sample && bit_q == STOP && line;
  assign data_o  = data_q;
  assign break_o = state_q == Broken;

endmodule
